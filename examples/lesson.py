"""The lesson of docs/tutorial.md with its solutions: what a class may have at the end."""

import numpy as np

from protocol.schemes.framing import Deframer
from wyner import design, eavesdrop, run, vary

system = design("sustained")
recorded = run(system, steps=400, seed=1, message=b"Hi")

x, offers, cipher = recorded.x[0], recorded.candidates[0], recorded.cipher[0]
A, B = np.array(system.scenario.A), np.array(system.scenario.B)
D_e = np.array([0.96, 0.96])  # half-widths of the box that Eve knows to hold d
key = recorded.key[0]

# --- exercise 1 ---


def distances(k):
    """How far the next state lies from each prediction, in units of D_e."""
    predictions = [A @ x[k] + B @ u for u in offers[k]]
    return np.array([np.max(np.abs(x[k + 1] - c) / D_e) for c in predictions])


guesses = np.array([distances(k).argmin() for k in range(recorded.steps)])
agreed = key >= 0
print(f"{np.sum(guesses[agreed] == key[agreed])} of {agreed.sum()} keys right")
assert np.all(guesses[agreed] == key[agreed])

# --- exercise 2 ---


near = np.array([np.sort(distances(k)) for k in range(recorded.steps)])


def decoded(t):
    """The whole messages that come out if the threshold is t."""
    deframer, held, found = Deframer(2), None, []
    for k in range(recorded.steps):
        if held is not None:
            payload = deframer.push(int(cipher[k] - held) % 2)
            if payload is not None:
                found.append(payload)
            held = None
        elif near[k, 0] <= t < near[k, 1] <= 1:
            held = guesses[k]
    return found


thresholds = np.unique(near[near <= 1])
readings = {t: found for t in thresholds if (found := decoded(t))}
messages = {message for found in readings.values() for message in found}
print(f"{len(thresholds)} thresholds, messages found: {messages}")
assert messages == {b"Hi"}
assert len(thresholds) <= 2 * recorded.steps

# --- exercise 3 ---


for alpha in (1.5, 3.0, 8.0):
    system = design(vary(design("sustained").scenario, {"secrecy.alpha": alpha}))
    runs = run(system, steps=400, runs=10, seed=2)
    (eve,) = eavesdrop(runs, ["nearest-centre"])
    hidden = np.log2(2 * runs.steps + 1)  # thresholds that make a difference
    print(
        f"alpha {alpha}: {runs.rate.value:.2f} bit/s, "
        f"{eve.agreements / 10:.0f} bits a run by the paper's rule, "
        f"Eve has {eve.right} of {eve.agreements}; at most {hidden:.0f} bits can hide"
    )
    assert eve.right == eve.agreements
