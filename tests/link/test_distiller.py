"""What one end does for a block that gives no key: its rows go, and it is not announced."""

from protocol.link.distiller import NO_ROWS, BlockEnded, Distiller
from protocol.link.records import KeyRecord
from protocol.secret.blocks import NO_TAG, Schedule
from protocol.secret.bound import Assumption
from protocol.secret.nonces import Contribution
from runtime.chance import fresh_nonce

S = "1" * 16
SCHEDULE = Schedule(Assumption(0.95, eps_sec=1e-2), first=3, largest=6)


def test_a_block_that_lost_too_many_copies_is_not_extracted_and_its_rows_go() -> None:
    keys = Distiller(SCHEDULE, 2, fresh_nonce)
    lost = [Contribution(j, 1, None, None) for j in range(1, 4)]
    keys.resume(S, KeyRecord(), rows=lost)
    assert keys.tasks() == ()
    assert keys.ended() == (BlockEnded(S, 0, "poor"),)
    assert keys.rows().obsolete_rows == (range(1, 4),)
    assert keys.rows() == NO_ROWS
    assert keys.announcement() == (-1, NO_TAG)
