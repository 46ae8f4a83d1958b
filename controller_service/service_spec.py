"""The controller among the services."""

from runtime.health import look_at_status
from runtime.services import (
    CONTROLLER_FIELD,
    CONTROLLER_MANAGEMENT,
    END_STOP_S,
    PLANT_FIELD,
    PLANT_MANAGEMENT,
    Ends,
    Service,
    register,
)

register(
    Service(
        name="controller",
        summary="run the controller service",
        package="controller_service",
        command="controller_service.command",
        ends={
            "field": Ends((CONTROLLER_FIELD,), (PLANT_FIELD,)),
            "management": Ends((CONTROLLER_MANAGEMENT,), (PLANT_MANAGEMENT,)),
        },
        publishes={
            "field": ("offer",),
            "management": (
                "management/controller/hello",
                "management/controller/status",
                "management/reply/send",
            ),
        },
        health=look_at_status,
        stop_s=END_STOP_S,
    )
)
