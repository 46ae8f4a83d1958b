"""A service that prints what the plant publishes."""

from protocol.registry import provide

provide("service", "logger_service.service_spec")
