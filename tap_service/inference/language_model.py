"""How much a string of bytes looks like English text: character trigrams, smoothed.

The counts come from the text below, written for this purpose; no message of an experiment is in it.
A byte's plausibility is a log ratio: its probability as the next character of English over 1/256,
so that a string's sum compares "this is text" with "these are random bytes", whatever its length.
"""

from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

TEXT_WEIGHT: Final = 0.98
"""Probability that a byte of a message is text at all; the rest goes evenly to all bytes."""

_WEIGHTS: Final = (0.62, 0.28, 0.09, 0.01)
"""Of trigram, bigram, single character, and any printable character."""

_FIRST, _LAST = 32, 126
OTHER: Final = _LAST - _FIRST + 1
"""Class of every byte that is no printable ASCII character, and of the beginning."""

SAMPLE: Final = """\
The harbour was quiet when the first boat came in. Nobody had expected it before noon, and the \
men who were mending their nets on the stones looked up, counted the sails, and went on with \
their work. It is said that a town which lives from the sea learns to wait, and that those who \
cannot wait move inland sooner or later. The doctor had a different opinion. He thought that \
people waited because they had nothing better to do, and he told them so whenever they would \
listen to him.
Please send the report to the office by Friday. We will need three more pumps, a new valve for \
the second tank, and the keys of the store room. The pressure in the lower pipe is still too \
high; open the drain slowly and watch the gauge for ten minutes. If it falls below four, close \
it again and call me at once. Do not start the engine until the water is clear. The door code \
has changed, ask the guard for the new one. Someone must stay at the gate tonight.
There are many ways to bake bread, but they all begin with flour, water, salt and time. Mix them \
in a large bowl, cover it with a cloth and leave it alone until the dough has doubled. Heat the \
oven as hot as it will go. When the crust is brown and sounds hollow, take it out and let it \
cool before you cut it, however hungry you are.
In the winter of that year the river froze for the first time in memory. Children walked across \
to the island and came back with their pockets full of stones, each of which they believed to be \
a part of the old castle. Their mothers believed nothing of the kind, but kept the stones all \
the same. My brother built a sledge out of an old table. It went very well downhill and not at \
all uphill, which he called a fair beginning.
When we measure something, we compare it with something else that we have agreed upon. The \
result is never exact, and an honest table gives the error beside the value. A clock that is \
wrong by the same amount every day is more useful than one that is right now and then. This is \
why we keep records, why we repeat what we have done, and why we should be glad when somebody \
else gets another answer.
Meet me under the bridge at nine o'clock. Bring the map and the letter, and tell no one where \
you are going. The train leaves from platform two at half past six in the morning. I have left \
the money with your sister. Thank you for the flowers; they arrived this afternoon and are \
standing in the window. Can you come on Thursday instead? The meeting has been moved to the \
small room on the third floor. What time is it there? How far is the next village? Yes, I know \
the way. No, there is no hurry.
Turn the switch to the left, hold it for five seconds, then release it. The red light means that \
the battery is low. All units return to base. Change the set point to eighty degrees and lower \
the speed of the fan. Alarm four was false, reset it. The temperature of the reactor is stable, \
the level is normal, and the operator has been told. Stop the belt, check the sensor, clean the \
filter, and start again in manual mode. Keep this between us. The password will be given to you \
by hand.
She had been a teacher for thirty years before she began to write, and she wrote as she had \
taught: plainly, with examples, and with a short pause before anything that mattered. Her second \
book was about trees. It explained how they drink, how they warn each other, and why they never \
seem to be in any hurry. Most readers liked the pictures best, and she did not mind that in the \
least.
On the other side of the hill, between the orchard and the road, stood a house with green \
shutters. An old man lived there with two dogs and a great number of books. Every evening he \
walked as far as the mill, looked at the sky, and walked home again. What will the weather be \
tomorrow, people asked him. Much like today, he used to answer, unless it changes; and he was \
right more often than the newspaper.
"""


@cache
def table() -> NDArray[np.float64]:
    """Log ratios by class of the two characters before, and of the next: shape (96, 96, 96)."""
    classes = _classes()
    size = OTHER + 1
    text = classes[np.frombuffer(SAMPLE.encode("ascii").replace(b"\n", b" "), dtype=np.uint8)]
    tri = np.zeros((size, size, size))
    np.add.at(tri, (text[:-2], text[1:-1], text[2:]), 1.0)
    bi = np.zeros((size, size))
    np.add.at(bi, (text[:-1], text[1:]), 1.0)
    for first in range(size):  # the beginning of a message: any character after a space
        tri[first, OTHER] += bi[0] * 0.02
    bi[OTHER] += bi[0] * 0.02
    single = np.bincount(text, minlength=size).astype(float)
    flat = np.zeros(size)
    flat[:OTHER] = 1.0 / OTHER

    def shares(counts: NDArray[np.float64]) -> NDArray[np.float64]:
        total = counts.sum(axis=-1, keepdims=True)
        out = np.zeros_like(counts)
        np.divide(counts, total, out=out, where=total > 0)
        return out

    w3, w2, w1, w0 = _WEIGHTS
    p = w3 * shares(tri) + w2 * shares(bi)[None] + w1 * shares(single) + w0 * flat
    p /= p.sum(axis=-1, keepdims=True)
    p[..., OTHER] = 0.0
    ratios: NDArray[np.float64] = np.log(256 * (TEXT_WEIGHT * p + (1 - TEXT_WEIGHT) / 256))
    return ratios


@cache
def _classes() -> NDArray[np.intp]:
    codes = np.arange(256)
    classes = np.full(256, OTHER, dtype=np.intp)
    classes[_FIRST : _LAST + 1] = codes[_FIRST : _LAST + 1] - _FIRST
    return classes


def class_of(byte: NDArray[np.integer]) -> NDArray[np.intp]:
    """The class of each byte: its place among the printable characters, or :data:`OTHER`."""
    classes: NDArray[np.intp] = _classes()[byte]
    return classes
