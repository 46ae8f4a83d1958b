"""The kinds of NumPy array that the computations hand to each other."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Narrow = NDArray[np.float32]
Indices = NDArray[np.intp]
Integers = NDArray[np.integer[Any]]
Counts = NDArray[np.int64]
Flags = NDArray[np.bool_]
Symbols = Integers
"""Key and message symbols, -1 for none; as narrow as M allows."""
