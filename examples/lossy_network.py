"""Exactly once over a network that loses, repeats and reorders, with processes that die."""

from wyner import design
from wyner.simulate.faults import Faults
from wyner.simulate.network import Simulation

system = design("packed")
faults = Faults(loss=0.2, repeat=0.2, delay_s=0.1, crash=0.005, until_s=200.0)
messages = (b"first", b"second")
world = Simulation(system.scenario, system.law, seed=5, payloads=messages, faults=faults)
history = world.run(seconds=600.0, until=lambda: len(world.history.delivered) == 2)
print(f"{history.crashes} crashes, {len(history.plant)} transitions")
print(f"the plant has {history.inbox}")
