"""Twenty messages, each in a run of its own, and how many of them an eavesdropper reads whole."""

from wyner import eavesdrop, run

runs = run("sustained", steps=500, runs=20, seed=0, message=b"At six.")
(tap,) = eavesdrop(runs, ["list-decoder"])
print(f"{tap.name} names {tap.right} of {tap.agreements} key bits")
print(f"{tap.name} reads {tap.read} of {tap.delivered} messages")
