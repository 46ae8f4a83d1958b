"""Those who take part on the buses without being services: who watches, and who sends."""

from protocol.runtime.services import CONTROLLER_OPS, PLANT_OPS, TAP_INTEL, Ends, Service, register

register(
    Service(
        name="dashboard",
        ends={
            "ops": Ends((), (PLANT_OPS, CONTROLLER_OPS)),
            "intel": Ends((), (TAP_INTEL,)),
        },
    )
)
register(
    Service(
        name="operator",
        ends={"ops": Ends((), (CONTROLLER_OPS,))},
        publishes={"ops": ("ops/command/send", "ops/command/seal")},
    )
)
