"""Vectors and matrices of plain floats, as messages, scenarios and the agreement test hold them."""

from pydantic import FiniteFloat

Vector = tuple[float, ...]
Matrix = tuple[Vector, ...]

FiniteVector = tuple[FiniteFloat, ...]
"""The same as the field of a model: infinities and NaN are refused."""

FiniteMatrix = tuple[FiniteVector, ...]
