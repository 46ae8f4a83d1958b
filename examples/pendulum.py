"""A nonlinear pendulum under a linear model, and what a dead link may cost it."""

from controller_service.sets.dead_link import dead_link_budget
from wyner import design, run, vary

shipped = design("pendulum")
runs = run(shipped, steps=400, seed=2, message=b"upright")
print(f"{runs.rate.value:.1f} bit/s, recovered {runs.messages[0]}")
print(f"angle up to {abs(runs.x[0, 10:, 0]).max():.3f} rad")
for fallback in ("hold", "zero", "regulator"):
    system = design(vary(shipped.scenario, {"link.fallback": fallback}))
    steps = dead_link_budget(system.scenario, system.design)
    print(f"{fallback:10} {'for ever' if steps is None else f'{steps} steps at least'}")
