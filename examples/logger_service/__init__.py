"""A service that prints what the plant publishes: what it does on which bus."""

from runtime.services import PLANT_FIELD, SERVICES, Ends, Service

SERVICES["logger"] = Service(
    name="logger",
    summary="write down what the field bus carries",
    package="logger_service",
    ends={"field": Ends((), (PLANT_FIELD,))},
    publishes={},
)
