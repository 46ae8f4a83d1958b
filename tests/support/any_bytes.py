"""An expectation of nothing."""

import numpy as np

from tap_service.inference.expectation import ANY, Expectation, Kind


def any_bytes() -> Expectation:
    """Of one who expects nothing: every byte is as likely."""
    return Expectation.of([Kind(ANY, 1.0, lambda at: np.full((len(at.last), 256), 1 / 256))])
