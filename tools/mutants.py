"""Mutation testing: how many broken programs the tests of a room notice.

A mutant is the program with one small thing changed. ``mutmut`` makes them; ``tools.sieve`` runs
each against the room's tests, in a process forked after everything is imported, and stops at the
first test that fails. ``python -m tools.mutants --sample 300`` tries so many of each room, drawn
with a stated seed, and prints the share killed (of a sample: with its 95 % Clopper-Pearson
interval), the pace and the survivors. What was tried is kept in ``build/mutants``, and is tried
again only where the function or the tests have changed: stop it with Ctrl-C, and it goes on.
"""

import argparse
import ast
import difflib
import hashlib
import inspect
import json
import os
import random
import re
import shutil
import subprocess
import sys
import textwrap
import time
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Final, NamedTuple

from protocol.statistics import clopper_pearson
from tools.sieve import LEFT_OUT


def _files(room: str, names: str) -> tuple[str, ...]:
    return tuple(f"tests/{room}/test_{name}.py" for name in names.split())


SOURCES: Final[Mapping[str, tuple[str, ...]]] = {
    "schemes": ("protocol/schemes",),
    "link": ("protocol/link", "controller_service/core.py", "plant_service/core.py"),
    "check": ("wyner/runs/check",),
    "tap": ("tap_service/capture", "tap_service/eavesdroppers", "tap_service/inference"),
}
"""A room's folders and files: the link's rules stand at both ends' cores."""

ROOMS: Final[Mapping[str, tuple[str, ...]]] = {
    "schemes": _files("schemes", "framing switched pipelined own_scheme"),
    "link": (
        *_files("link", "refusals controller_tells plant_tells statuses guard guarded coins"),
        *_files("link", "keying events rules fallback pacing timers channel output_rule"),
        *_files("link", "transcripts plant_session controller_session session_tables"),
        *_files("link", "predictions last_keys"),
        *_files("secret", "keyed_coin guarded_link"),
        *_files("link", "meeting appearances tallies"),
        *_files("runtime", "sealing perform"),
        *_files("simulate", "outputs missed"),
        *_files("adapters", "device"),
        *_files("secret", "keyed_link"),
        *_files("link", "session_machine"),
        *_files("simulate", "network"),
    ),
    "check": _files(
        "runs/check",
        "paper key_blocks sealed rare_runs words seal parts deaths outputs guarded check",
    ),
    "tap": (
        *_files("tap", "transcript channel capture thresholds list_decoding message_halves"),
        *_files("tap", "message_graph gap_smoother miss_rate identification fitted_shape english"),
        *_files("tap", "key_solver analysis ladder mixture_smoother particle_smoother outputs"),
        *_files("cli", "tap"),
        *_files("tap", "text"),
    ),
}
"""A room, and the tests that have to notice; those that notice much in little time come first."""

BUILD: Final = Path("build/mutants")
TREE: Final = BUILD / "tree"
INDEX: Final = BUILD / "index.json"
TRIED: Final = BUILD / "tried.jsonl"
_NUMBER: Final = re.compile(r"__mutmut_(orig|\d+)")


class Mutant(NamedTuple):
    """One broken program.

    Parameters
    ----------
    name : str
        Module, function and number, as mutmut names it.
    key : str
        Hash of the function before and after: the same key is the same mutant.
    before, after : str
        The function's text.
    first, last : int
        Lines of the statement that is changed, in the file with all mutants, as it is without one.
    """

    name: str
    key: str
    before: str
    after: str
    first: int
    last: int

    @property
    def function(self) -> str:
        """The mutated function, as the trampoline names it."""
        return self.name.partition("__mutmut_")[0]

    def difference(self) -> list[str]:
        """The lines that changed."""
        before, after = (_NUMBER.sub("", text).splitlines() for text in (self.before, self.after))
        diff = list(difflib.unified_diff(before, after, n=0, lineterm=""))[2:]
        return [line for line in diff if not line.startswith("@@")]


def generate(source: str, path: Path) -> tuple[str, list[Mutant]]:
    """The file with all its mutants behind trampolines, and the mutants."""
    from mutmut.mutation.file_mutation import mutate_file_contents

    made = mutate_file_contents(str(path), source)
    lines = made.code.splitlines()
    spans = made.line_span_by_function_name
    text = {name: "\n".join(lines[span.start - 1 : span.end]) for name, span in spans.items()}
    module = ".".join(path.with_suffix("").parts).removesuffix(".__init__")
    mutants = []
    for name in made.mutant_names:
        original = name.partition("__mutmut_")[0] + "__mutmut_orig"
        key = hashlib.sha256(f"{module}\n{text[original]}\n{text[name]}".encode()).hexdigest()
        first, last = (spans[original].start + at for at in changed(text[original], text[name]))
        row = Mutant(f"{module}.{name}", key[:16], text[original], text[name], first, last)
        mutants.append(row)
    return made.code, mutants


def changed(before: str, after: str) -> tuple[int, int]:
    """First and last line, from 0, of the innermost statement of a function that a mutant changed.

    Of a statement with a body that is what stands before the body; a change of the function's own
    head is one of the whole function.
    """
    old, new = (_NUMBER.sub("", text).splitlines() for text in (before, after))
    found = difflib.SequenceMatcher(None, old, new, autojunk=False).get_opcodes()
    places = [op for op in found if op[0] != "equal"]
    first, last = places[0][1], max(places[0][1], places[-1][2] - 1)
    spot = (0, len(old) - 1)
    for node in list(ast.walk(ast.parse(textwrap.dedent(before))))[2:]:  # inside the function
        if isinstance(node, ast.stmt | ast.ExceptHandler):
            start, end = node.lineno - 1, (node.end_lineno or node.lineno) - 1
            if body := getattr(node, "body", None):
                end = max(start, body[0].lineno - 2)
            if start <= first and last <= end and end - start < spot[1] - spot[0]:
                spot = start, end
    return spot


def _room_of(path: Path) -> str | None:
    """The room whose source a file is."""
    names = {str(path), str(path.parent)}
    return next((room for room, sources in SOURCES.items() if names & set(sources)), None)


def prepare(wanted: Collection[str]) -> dict[str, list[Mutant]]:
    """A copy of the checkout with the mutants of these rooms in it, and each room's mutants."""
    listed = subprocess.run(
        ["git", "ls-files", "-co", "--exclude-standard"], capture_output=True, text=True, check=True
    ).stdout.splitlines()
    index = json.loads(INDEX.read_text()) if INDEX.exists() else {}
    made_by = (inspect.getsource(generate) + inspect.getsource(changed)).encode()
    kept = {}
    for name in listed:
        path = Path(name)
        if not path.exists():
            continue
        (TREE / path).parent.mkdir(parents=True, exist_ok=True)
        room = _room_of(path)
        if room not in wanted or path.suffix != ".py":
            shutil.copy2(path, TREE / path)
            continue
        digest = hashlib.sha256(path.read_bytes() + made_by).hexdigest()
        if index.get(name, {}).get("digest") != digest:
            code, mutants = generate(path.read_text(), path)
            (TREE / path).write_text(code)
            index[name] = {"digest": digest, "mutants": mutants}
        kept[name] = index[name]
    for path in [p for top in ("tests", "tools") for p in (TREE / top).rglob("*.py")]:
        if str(path.relative_to(TREE)) not in listed:
            path.unlink()
    INDEX.write_text(json.dumps(kept))
    rooms: dict[str, list[Mutant]] = {room: [] for room in wanted}
    for name, entry in sorted(kept.items()):
        rooms[_room_of(Path(name)) or ""] += [Mutant(*row) for row in entry["mutants"]]
    return rooms


def drawn(mutants: Sequence[Mutant], count: int | None, seed: int) -> list[Mutant]:
    """``count`` of them, or all where none is asked for.

    A larger sample holds the smaller one, and a change of the program changes the sample little.
    """
    if count is None or count >= len(mutants):
        return list(mutants)
    return sorted(mutants, key=lambda m: random.Random(f"{seed} {m.key}").random())[:count]


def told(room: str, of: int, tried: Iterable[Mutant], fate: Mapping[str, str]) -> str:
    """A room's share, and the survivors."""
    done = [m for m in tried if m.key in fate]
    if not done:
        return f"{room}: none of {of} tried"
    survivors = [m for m in done if fate[m.key] in ("survived", "not reached")]
    killed, share = len(done) - len(survivors), 1 - len(survivors) / len(done)
    low, high = clopper_pearson(killed, len(done), 0.025)
    sampled = f" [{low:.1%}, {high:.1%}]" if len(done) < of else ""
    lines = [f"{room}: {killed} of {len(done)} killed, {share:.1%}{sampled}, of {of} mutants"]
    for m in survivors:
        lines += [f"  {fate[m.key]}: {m.name}", *(f"    {line}" for line in m.difference())]
    return "\n".join(lines)


def fates(tried: Path) -> dict[str, str]:
    """What became of each mutant, by key; the latest line counts."""
    lines = tried.read_text().splitlines() if tried.exists() else []
    return {row["key"]: row["fate"] for row in map(json.loads, lines) if "fate" in row}


def main(argv: Sequence[str] | None = None) -> int:
    """Try all mutants or a sample, and tell of them."""
    parser = argparse.ArgumentParser(prog="python -m tools.mutants", description=__doc__)
    parser.add_argument("--room", choices=ROOMS, help="of one room only")
    parser.add_argument("--sample", type=int, metavar="N", help="N mutants of each room")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args(argv)
    code = 0
    for room, mutants in prepare([args.room] if args.room else list(ROOMS)).items():
        chosen = drawn(mutants, args.sample, args.seed)
        chart = BUILD / "chosen.json"
        chart.write_text(json.dumps([[m.name, m.key, m.first, m.last] for m in chosen]))
        started = time.monotonic()
        known = len(fates(TRIED))
        sifted = subprocess.run(
            [sys.executable, "-m", "tools.sieve", chart.resolve(), TRIED.resolve(), *ROOMS[room]],
            cwd=TREE,
            env=os.environ | {"PYTHONPATH": str(TREE.resolve())},
            check=False,
        )
        if sifted.returncode != LEFT_OUT:
            sifted.check_returncode()
        code = max(code, sifted.returncode)
        fate = fates(TRIED)
        hours = (time.monotonic() - started) / 3600
        print(told(room, len(mutants), chosen, fate))
        print(f"  {(len(fate) - known) / hours:.0f} new ones an hour", flush=True)
    return code


if __name__ == "__main__":
    sys.exit(main())
