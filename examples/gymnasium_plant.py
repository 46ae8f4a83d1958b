"""Gymnasium's Pendulum-v1 as the plant; needs wyner[gym]."""

from wyner import design, eavesdrop, run

runs = run(design("gymnasium-pendulum"), steps=300, seed=6, message=b"gym")
print(f"{runs.rate.value:.0f} bit/s, recovered {runs.messages[0]}")
(tap,) = eavesdrop(runs, ["nearest-centre"])
print(f"{tap.name} had {tap.keys.value:.0%} of the key symbols right: the rate is no secrecy")
