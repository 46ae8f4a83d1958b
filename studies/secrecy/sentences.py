"""The messages of the reading study: English sentences of 48 to 59 characters.

None of them is in the text from which English is counted (a test).
"""

from typing import Final

SENTENCES: Final = (
    "The auditors found two ledgers that nobody would claim.",
    "Rinse the beakers twice and dry them on the wire rack.",
    "Our cousin in Lisbon breeds pigeons for long races.",
    "Shift the night roster so that Petra gets a free Sunday.",
    "A violinist left her bow on the tram to Kreuzberg.",
    "Pay the ferryman in silver and ask for no receipt.",
    "The glacier has shrunk by a mile since our last visit.",
    "Mind the third stair, it creaks and wakes the dog.",
    "Somebody swapped the labels on the vaccine boxes.",
    "Quarterly figures look dull but the outlook is bright.",
    "Tighten the bolts crosswise and never all at once.",
    "The choir rehearses on Fridays in the old gymnasium.",
    "Vents on level nine are stuck, so expect warm offices.",
    "My grandmother pickled walnuts in a blue stone jar.",
    "Feed the kiln with birch until the cones start to bend.",
    "The ambassador prefers tea and dislikes long speeches.",
    "Two falcons nest above the clock on the town hall.",
    "Swap your rucksack with the man in the checked scarf.",
    "Every spring the flood leaves clay on our tennis court.",
    "The editor cut my favourite chapter without a word.",
    "Keep the yeast at blood heat or the dough stays flat.",
    "Smugglers use the quarry road when the moon is new.",
    "An eclipse will darken the bay on the ninth of August.",
    "The robot arm drops every seventh cup it picks up.",
    "Grease the hinges, they can be heard across the yard.",
    "Half the jury wanted lunch more than they wanted truth.",
    "Drones circled the refinery for an hour last evening.",
    "You owe the tailor for a waistcoat and four buttons.",
    "The beacon on Gull Rock has been dark since Thursday.",
    "Salt trucks are parked beside the stadium tonight.",
    "Her thesis on beetles won a prize and a trip to Kyoto.",
    "Do not mix the resin in a plastic bucket this time.",
    "The crane driver went home sick shortly after eight.",
    "A cracked insulator cut the power to eleven streets.",
    "Send the cello by rail and insure it for the full sum.",
    "The mayor plans to fly to Oslo under a borrowed name.",
    "Owls hunt in the orchard as soon as the tractors stop.",
    "Their bakery smells of cinnamon from five o'clock on.",
    "The last buyer backed out because of the leaking dome.",
    "Bees swarmed on the chimney of the customs house.",
)
