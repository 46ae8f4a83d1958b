"""How many sessions a promise about D_c costs, and what a scale of D_c promises."""

import random

from wyner.fit.conformal import (
    conformal_scale,
    rank,
    sessions_needed,
    violation_bound,
)

for violation in (0.01, 0.001):
    needed = sessions_needed(violation, 0.999)
    print(f"at most {violation:g} of sessions leave D_c, confidence 0.999: {needed} sessions")

chance = random.Random(8)
scores = [max(chance.random() for _ in range(200)) for _ in range(100)]
scale = conformal_scale(scores, 0.05)
print(f"scale {scale:.4f}: the {rank(100, 0.05)}th of 100 scores")

fresh = [max(chance.random() for _ in range(200)) > scale for _ in range(300)]
bound = violation_bound(300, sum(fresh), 0.99)
print(f"{sum(fresh)} of 300 fresh sessions left it: at most {bound:.3f}, confidence 0.99")
