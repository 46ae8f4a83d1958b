"""The paper's own example: its rate at alpha = 8 (Fig. 7), and who names the keys."""

from wyner import design, eavesdrop, run, vary

scenario = design("paper").scenario
for x0 in ([1.0, -0.5], [4.0, -2.0], [-12.0, 6.0]):
    system = design(vary(scenario, {"plant.initial_state": x0}))
    runs = run(system, steps=50, runs=100, seed=7)
    print(f"from {x0}: {runs.rate.value:.2f} [{runs.rate.low:.2f}, {runs.rate.high:.2f}] bit/s")
    for tap in eavesdrop(runs, ["set-membership", "nearest-centre"]):
        print(f"  {tap.name} names {tap.right} of {tap.agreements} key bits")
