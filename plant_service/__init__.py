"""The plant: simulated or driven, its coin, and the receiving end of the link."""

import runtime.early  # noqa: F401
