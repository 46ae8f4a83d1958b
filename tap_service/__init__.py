"""The tap: mirrors the field bus, and lets eavesdroppers guess at what it carries."""

import runtime.early  # noqa: F401
from protocol.registry import provide

provide("service", "tap_service.service_spec")
