"""A run as a data frame: how far apart the candidates are when a key is agreed."""

from wyner import run

frame = run("sustained", steps=400, runs=10, seed=7).frame()
frame["agreed"] = frame["key"] >= 0
frame["other"] = frame[["gauge_0", "gauge_1"]].max(axis=1)
print(frame.groupby("agreed")["other"].describe()[["count", "min", "50%", "max"]].round(2))
print(frame.groupby("run")["agreed"].sum().rename("keys").to_string())
