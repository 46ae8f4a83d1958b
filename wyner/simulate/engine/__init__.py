"""The closed loop over many runs: the same system as the services, together where it can be.

The layers: :mod:`~wyner.simulate.engine.draws` gives each run the random numbers that a single run
of the services would take; :mod:`~wyner.simulate.engine.loop` simulates plant and laws and keeps
what the agreement test needs; :mod:`~wyner.simulate.engine.link` follows the scheme over it;
:mod:`~wyner.simulate.engine.taps` lets eavesdroppers hear it.
Neither law nor coin depends on alpha, so that one simulation serves every alpha.
:mod:`~studies.attacks.attacked` stands between the ends, with an attacker and defences.
"""

from wyner.simulate.engine.draws import cipher_symbols
from wyner.simulate.engine.link import LinkCounts, Transfer, follow, transfer
from wyner.simulate.engine.loop import (
    CHUNK_RUNS,
    Between,
    Law,
    Runs,
    SimulationError,
    chunks,
    simulate_runs,
)

__all__ = [
    "CHUNK_RUNS",
    "Between",
    "Law",
    "LinkCounts",
    "Runs",
    "SimulationError",
    "Transfer",
    "chunks",
    "cipher_symbols",
    "follow",
    "simulate_runs",
    "transfer",
]
