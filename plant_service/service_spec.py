"""The plant among the services."""

from runtime.health import look_at_status
from runtime.services import PLANT_FIELD, PLANT_OPS, Ends, Service, register

register(
    Service(
        name="plant",
        summary="run the plant service with its simulation",
        package="plant_service",
        command="plant_service.command",
        ends={"field": Ends((PLANT_FIELD,)), "ops": Ends((PLANT_OPS,))},
        publishes={
            "field": ("measurement",),
            "ops": (
                "ops/plant/hello",
                "ops/plant/model",
                "ops/plant/status",
                "ops/plant/receipt",
                "ops/keys/word",
                "ops/keys/request",
                "ops/keys/answer",
            ),
        },
        health=look_at_status,
    )
)
