"""What more candidates bring and cost: rate and control effort of the law packed."""

import numpy as np

from wyner import SynthesisError, design, run, vary

base = design("packed").scenario
for size in (2, 3, 4, 5, 6):
    try:
        runs = run(vary(base, {"secrecy.candidates": size}), steps=400, runs=20, seed=4)
    except SynthesisError as error:
        print(f"M = {size}: {str(error).splitlines()[0][:90]}")
        continue
    effort = float(np.mean(runs.u[:, 50:] ** 2))
    print(f"M = {size}: {runs.rate.value:5.2f} bit/s, mean square input {effort:.3f}")
