"""The plant: simulated or driven, its coin, and the receiving end of the link."""

import runtime.early  # noqa: F401
from protocol.registry import provide

provide("plant", "plant_service.adapters.registry")
provide("service", "plant_service.service_spec")
