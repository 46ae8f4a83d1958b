"""A plant of one's own as a dictionary: a mass on a rail, pushed, with a disturbed force."""

from wyner import ScenarioError, build, design, run, vary

T = 0.1
rail = build(
    {
        "name": "rail",
        "plant": {
            "A": [[1.0, T], [0.0, 1.0]],
            "B": [[T * T / 2], [T]],
            "period_s": T,
            "initial_state": [0.0, 0.0],
            "disturbance": {"half_widths": [0.002, 0.02]},
        },
        "defender": {"disturbance": {"half_widths": [0.0024, 0.024]}},
        "control": {
            "law": "sustained",
            "horizon": 20,
            "inputs": {"half_widths": [2.0]},
            "regulator": {"next_state": [1.0, 1.0], "input": [1.0]},
            "costs": [{"next_state": 1.0}, {"input": 1.0}],
        },
        "secrecy": {"alpha": 8.0},
    }
)
runs = run(design(rail), steps=500, runs=20, seed=5)
tested = runs.count * runs.steps - (runs.message_symbol >= 0).sum()
print(f"p = {runs.agreements.sum() / tested:.3f}, {runs.rate.value:.2f} bit/s")

try:
    vary(rail, {"control.inputs.half_widths": [2.0, 2.0]})
except ScenarioError as error:
    print(error)
