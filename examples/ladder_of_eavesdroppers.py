"""How much each eavesdropper of the ladder gets of the same runs; blind guessing has one half."""

from wyner import eavesdrop, run

runs = run("sustained", steps=400, runs=5, seed=2, message=b"Hi")
names = ["set-membership", "nearest-centre", "learning", "oracle"]
print(f"{'eavesdropper':16} keys right (95 %)")
for tap in eavesdrop(runs, names):
    keys = tap.keys
    print(f"{tap.name:16} {keys.value:6.1%}  [{keys.low:.1%}, {keys.high:.1%}]")
