"""What a side traces and logs of its key blocks; nothing in it is secret."""

from typing import Any, NamedTuple

from protocol.link.distiller import BlockEnded, Distiller
from protocol.link.effects import Effects, Extract, Notice, Tell
from protocol.secret.blocks import ExtractedBlock, ExtractionFailed


class Appearances(NamedTuple):
    """A message leaves this end so many ``times`` from step k on, give or take one."""

    session: str | None
    k: int
    times: int

    def as_event(self) -> dict[str, Any]:
        """As a line of a trace."""
        return {"event": "appearances", **self._asdict()}


def appeared(keys: Distiller, session: str | None, k: int, count: int) -> Effects:
    """What an end does after its number of links has changed."""
    changed = keys.appear(count)
    if not keys.on:
        return
    yield Tell(Appearances(session, k, count))
    if changed and keys.crowded:
        yield Notice(f"keys stop: {keys.crowded}", "error", "appearances")
    elif changed:
        text = f"keys go on: a message leaves {count} {'time' if count == 1 else 'times'} again"
        yield Notice(text, "info", "appearances")


def extraction_done(keys: Distiller, block: ExtractedBlock | ExtractionFailed) -> Effects:
    """What an end does after a block was extracted, or could not be."""
    if isinstance(block, ExtractedBlock):
        keys.extracted(block)
        yield from map(Extract, keys.tasks())
    else:
        keys.fail(block.reason)
        yield Notice(f"no key is made from here on: {block.reason}", "error")


def block_notices(keys: Distiller, ended: tuple[BlockEnded, ...]) -> Effects:
    """Log lines of what became of blocks."""
    for block in ended:
        if block.what == "unequal":
            name = f"key block {block.number} of session {block.session}"
            yield Notice(f"{name} differs from the partner's", "error")
        elif block.what == "confirmed" and block.number == 0 and keys.schedule is not None:
            claim = keys.schedule.assumption.sentence()
            yield Notice(f"first keys of session {block.session}: {claim}")
