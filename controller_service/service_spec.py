"""The controller among the services."""

from runtime.health import look_at_status
from runtime.services import (
    CONTROLLER_FIELD,
    CONTROLLER_OPS,
    PLANT_FIELD,
    PLANT_OPS,
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
            "ops": Ends((CONTROLLER_OPS,), (PLANT_OPS,)),
        },
        publishes={
            "field": ("offer", "sealed"),
            "ops": (
                "ops/controller/hello",
                "ops/controller/status",
                "ops/reply/send",
                "ops/reply/seal",
                "ops/keys/word",
                "ops/keys/request",
                "ops/keys/answer",
            ),
        },
        health=look_at_status,
    )
)
