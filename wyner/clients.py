"""Those who are no services of the loop: who watches and who sends."""

from runtime.services import (
    CONTROLLER_MANAGEMENT,
    PLANT_MANAGEMENT,
    TAP_ADVERSARY,
    Ends,
    Service,
    register,
)

register(
    Service(
        name="dashboard",
        ends={
            "management": Ends((), (PLANT_MANAGEMENT, CONTROLLER_MANAGEMENT)),
            "adversary": Ends((), (TAP_ADVERSARY,)),
        },
    )
)
register(
    Service(
        name="operator",
        ends={"management": Ends((), (CONTROLLER_MANAGEMENT,))},
        publishes={"management": ("management/command/send", "management/command/stop-keys")},
    )
)
