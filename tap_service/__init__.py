"""The tap: mirrors the field bus, and lets eavesdroppers guess at what it carries."""

import runtime.early  # noqa: F401
