"""The rate against alpha with its band, drawn on axes of one's own (the paper's Fig. 7)."""

import matplotlib.pyplot as plt
import numpy as np

from wyner import design, draw_rate, run, vary

figure, axes = plt.subplots()
alphas = np.linspace(1.0, 8.0, 15)
for name in ("paper", "sustained"):
    system = design(name)
    start = design(vary(system.scenario, {"plant.initial_state": [1.0, -0.5]}))
    draw_rate(run(start, steps=250, runs=200, seed=3), axes, alphas, f"law {name}")
axes.set_title("250 steps from (1.0, -0.5)")
figure.savefig("rate.png")
print("wrote rate.png")
