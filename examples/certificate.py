"""What sessions that stayed in D_c promise, and what a scale of D_c promises."""

import random

from wyner.fit.conformal import CONFIDENCE, conformal_scale, rank, violation_bound

for sessions in (100, 1000):
    bound = violation_bound(sessions, 0)
    print(f"none of {sessions} sessions left D_c: at most {bound:.4f}, confidence {CONFIDENCE}")

chance = random.Random(8)
scores = [max(chance.random() for _ in range(200)) for _ in range(100)]
scale = conformal_scale(scores, 0.05)
print(f"scale {scale:.4f}: the {rank(100, 0.05)}th of 100 scores")

fresh = [max(chance.random() for _ in range(200)) > scale for _ in range(300)]
bound = violation_bound(300, sum(fresh))
print(f"{sum(fresh)} of 300 fresh sessions left it: at most {bound:.3f}, confidence {CONFIDENCE}")
