"""One agreed step, drawn as the paper's Fig. 4, and the sets that the state runs through."""

import matplotlib.pyplot as plt

from wyner import design, draw_agreement, draw_sets, run, vary

far = vary(design("sustained").scenario, {"plant.initial_state": [4.0, -2.0]})
system = design(far)
runs = run(system, steps=60, runs=3, seed=4)
figure, (left, right) = plt.subplots(1, 2, figsize=(9, 4))
draw_sets(system, left, [0, 1, 2, 4, 6], runs)
draw_agreement(runs, right)
figure.savefig("step.png")
print("wrote step.png")
