"""The control side: sets computed offline, the laws evaluated online, and the service."""

import runtime.early  # noqa: F401
from protocol.registry import provide

provide("law", "controller_service.laws.registry")
provide("service", "controller_service.service_spec")
