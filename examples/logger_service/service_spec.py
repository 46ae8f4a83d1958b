"""The row: what the logger does on which bus."""

from runtime.health import look_at_status
from runtime.services import PLANT_FIELD, Ends, Service, register

register(
    Service(
        name="logger",
        summary="write down what the field bus carries",
        package="logger_service",
        command="logger_service.command",
        ends={"field": Ends((), (PLANT_FIELD,))},
        publishes={},
        health=look_at_status,
    )
)
