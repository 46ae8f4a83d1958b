"""The plant among the services."""

from runtime.health import look_at_status
from runtime.services import END_STOP_S, PLANT_FIELD, PLANT_MANAGEMENT, Ends, Service, register

register(
    Service(
        name="plant",
        summary="run the plant service with its simulation",
        package="plant_service",
        command="plant_service.command",
        ends={"field": Ends((PLANT_FIELD,)), "management": Ends((PLANT_MANAGEMENT,))},
        publishes={
            "field": ("measurement",),
            "management": (
                "management/plant/hello",
                "management/plant/model",
                "management/plant/status",
            ),
        },
        health=look_at_status,
        stop_s=END_STOP_S,
    )
)
