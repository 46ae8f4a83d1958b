"""Send a message through the paper's plant, and see that an eavesdropper reads it."""

from wyner import design, eavesdrop, run

system = design("sustained")
runs = run(system, steps=1200, seed=1, message=b"Hi")

print(f"sets T_0 to T_{system.horizon}, gain K = {system.gain.round(3).tolist()}")
print(f"agreed {runs.agreements[0]} key symbols in {runs.steps} steps")
print(f"the plant recovered {runs.messages[0]}")
for tap in eavesdrop(runs, ["set-membership", "nearest-centre"]):
    print(f"{tap.name} had {tap.keys.value:.0%} of the key symbols right")
