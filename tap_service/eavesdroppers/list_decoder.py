"""`list-decoder`: sweeps the hidden threshold and keeps every decoding that is consistent.

She knows f_c and D_e (model 10), so t_e = 1 in units of D_e, and only t_c = 1 / alpha is hidden.
Over N steps at most 2N + 1 thresholds give different decodings. She makes them all
(:mod:`tap_service.inference.list_decoding`), and the frame's check picks the one. The key symbols
are the nearest candidates', as for `nearest-centre`. What she missed she does not infer: such a
step counts as one without an agreement.
"""

from typing import ClassVar

from protocol.knowledge import Knowledge
from tap_service.eavesdroppers.base import Model
from tap_service.eavesdroppers.reading import Reading


class ListDecoder(Reading):
    """Follows every threshold at once and ranks by frame check and plausibility."""

    name: ClassVar[str] = "list-decoder"
    follows: ClassVar[bool] = True

    def __init__(self, knowledge: Knowledge) -> None:
        super().__init__(knowledge)
        self.model = Model.of(knowledge, self.name)
