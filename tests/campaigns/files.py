"""Files that nobody should read: ``python -m tests.campaigns.files --count 20000``.

Every file that a command reads, with bytes changed, cut, repeated, put in; fields of its JSON and
cells of its CSV replaced; and what was never such a file, up to 16 MB. Each must end in an answer,
or in one clear line and exit code 2 (a check that fails: 1), within a bounded memory.
"""

import argparse
import contextlib
import io
import json
import random
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.check import make_run
from runtime.command import carry_out
from runtime.errors import UsageError
from runtime.files import write_atomically
from runtime.run_folder import (
    BELIEFS,
    CAPTURE,
    CONTROLLER_JOURNAL,
    CONTROLLER_STATUS,
    CONTROLLER_TRACE,
    GUESSES,
    KNOWLEDGE,
    MANIFEST,
    PLANT_JOURNAL,
    PLANT_STATUS,
    PLANT_TRACE,
    SCENARIO,
)
from runtime.scenario_file import load_scenario
from tests.campaigns.fuzz import LARGEST_BYTES, NUMBERS, TEXTS, megabytes
from tools.rehearsal import Rehearsal
from wyner.cli.main import main as wyner
from wyner.sweeps import SWEEPS
from wyner.sweeps.grid import SweepError, code_version, load_sweep

ROOT = Path(__file__).resolve().parents[2]
SECONDS = 30.0
"""A reader may take so long on the busiest machine."""


class Target(NamedTuple):
    """A file of the folder, and what reads it."""

    file: Path
    read: Callable[[Path], int]


def command(*arguments: str) -> Callable[[Path], int]:
    """A command line; ``RUN`` in it is the run's folder."""
    return lambda run: wyner([a.replace("RUN", str(run)) for a in arguments])


def loader(load: Callable[[Path], object]) -> Callable[[Path], int]:
    """Something that a command calls before it does more, within what is around each command."""

    def called(run: Path) -> int:
        def answer() -> int:
            load(run)
            return 0

        return carry_out(answer)

    return called


def _sweep(run: Path) -> None:
    try:
        load_sweep(run / "sweep.toml")
    except SweepError as error:
        raise UsageError(str(error)) from None


def _fleet(run: Path) -> None:
    from runtime.fleet import read_fleet

    read_fleet(run / "fleet.toml")


def _secret(run: Path) -> None:
    from runtime.key_opening import open_key_maker

    keys = load_scenario(ROOT / "runtime/scenarios/keys.toml")
    (run / "k.sqlite3").unlink(missing_ok=True)
    open_key_maker(run / "k.sqlite3", "plant", keys, None, run / "secret")


def _knowledge(run: Path) -> None:
    from tap_service.command import read_knowledge

    read_knowledge(str(run / KNOWLEDGE))


def _tls(run: Path) -> int:
    ends = [
        "--connect",
        "management=tls/127.0.0.1:9",
        "--tls",
        f"management={run}/certs",
        "--timeout",
        "0.01",
    ]
    return wyner(["send", "hi", *ends])


CHECK = command("check", "RUN")
TARGETS: dict[str, Target] = {
    "scenario": Target(SCENARIO, command("scenarios", "RUN/scenario.toml", "--knowledge", "RUN/k")),
    "scenario of a run": Target(SCENARIO, CHECK),
    "fleet file": Target(Path("fleet.toml"), loader(_fleet)),
    "sweep": Target(Path("sweep.toml"), loader(_sweep)),
    "secret": Target(Path("secret"), loader(_secret)),
    "certificate": Target(Path("certs/cert.pem"), _tls),
    "key of a certificate": Target(Path("certs/key.pem"), _tls),
    "authority": Target(Path("certs/ca.pem"), _tls),
    "knowledge": Target(KNOWLEDGE, loader(_knowledge)),
    "plant's trace": Target(PLANT_TRACE, CHECK),
    "controller's trace": Target(CONTROLLER_TRACE, CHECK),
    "trace reported": Target(PLANT_TRACE, command("report", "RUN", "--output", "RUN/r.html")),
    "trace scored": Target(PLANT_TRACE, command("score", "RUN")),
    "capture": Target(CAPTURE, CHECK),
    "capture replayed": Target(CAPTURE, command("score", "RUN", "--decode")),
    "capture exported": Target(
        CAPTURE, command("export", "RUN", "--to", "csv", "--steps", "--truth", "--output", "RUN/c")
    ),
    "guesses": Target(GUESSES, command("score", "RUN")),
    "beliefs": Target(BELIEFS, command("score", "RUN")),
    "manifest": Target(MANIFEST, CHECK),
    "manifest reported": Target(MANIFEST, command("report", "RUN", "--output", "RUN/r.html")),
    "plant's status": Target(PLANT_STATUS, command("status", "RUN")),
    "controller's status": Target(CONTROLLER_STATUS, command("status", "RUN", "--json")),
    "plant's journal": Target(PLANT_JOURNAL, CHECK),
    "controller's journal": Target(CONTROLLER_JOURNAL, CHECK),
    "key store": Target(Path("plant/keys.sqlite3"), command("score", "RUN", "--unsealed")),
    "rows of a sweep": Target(
        Path("rows.csv"), command("sweep", "RUN/rows.csv", "--plot", "RUN/p.svg")
    ),
}


def lay_out(run: Path) -> None:
    """A run's folder, and beside it one of each other file."""
    from protocol.messages import ControllerStatus, PlantStatus
    from runtime.keys.anchor import Anchor
    from runtime.keys.secret_file import make_secret
    from runtime.keys.store import KeyStore

    make_run(run, 120)
    for arguments in (
        ["scenarios", f"{run}/{SCENARIO}", "--knowledge", f"{run}/{KNOWLEDGE}"],
        ["certs", f"{run}/made", "--name", "operator"],
    ):
        assert wyner(arguments) == 0
    shutil.copytree(run / "made" / "operator", run / "certs")
    make_secret(run / "secret")
    with KeyStore(run / "plant/keys.sqlite3", "plant", create=True) as store:
        Anchor(run / "plant/keys.sqlite3").announce(1)
        store.refuse("a campaign's")
    _let_the_tap_guess(run)
    statuses = [a.message for batch in Rehearsal().arrivals(50) for a in batch]
    for path, kind in ((PLANT_STATUS, PlantStatus), (CONTROLLER_STATUS, ControllerStatus)):
        write_atomically(run / path, next(s for s in statuses if isinstance(s, kind)).wire())
    identity = load_scenario(run / SCENARIO).identity()
    write_atomically(run / MANIFEST, json.dumps({"wyner": "0", **identity}).encode())
    rows = (ROOT / "docs/data/fig7-paper-20.csv").read_text().splitlines(keepends=True)
    (run / "rows.csv").write_text("".join(rows[:30]))
    shutil.copy(SWEEPS / "plants.toml", run / "sweep.toml")
    fleet = '[[loop]]\nid = "a"\nscenario = "sustained"\nmessage = "hi"\nseed = 1\n'
    (run / "fleet.toml").write_text(fleet + fleet.replace('"a"', '"b"'))


def _let_the_tap_guess(run: Path) -> None:
    """Guesses and beliefs of a tap that heard the capture."""
    from protocol.messages import Measurement, Offer
    from runtime.recording import read_lines
    from tests.campaigns.listeners import Tap

    with tempfile.TemporaryDirectory() as folder:
        tap = Tap(Path(folder), [])
        for line in read_lines(run / CAPTURE):
            if line.value is not None and line.value["event"] == "field":
                kind = Measurement if line.value["topic"] == "measurement" else Offer
                tap.hear(kind, json.dumps(line.value["message"]).encode())
        tap.close()
        for path in (GUESSES, BELIEFS):
            shutil.copy(Path(folder) / path, run / path)


def mutants(seed: int, original: bytes, name: str) -> Iterator[bytes]:
    """For ever: the file, changed."""
    draw = random.Random(f"{seed} {name}")
    while True:
        kind = draw.random()
        if kind < 0.002:
            yield draw.choice((b"[", b"\x00", b"a = ", b'{"a":', b"\n", b"-")) * (
                LARGEST_BYTES // 8
            )
        elif kind < 0.05:
            yield draw.choice((b"", b"[" * 20_000, b"\xff\xfe", draw.randbytes(300), b"\n" * 50))
        elif kind < 0.35 or original[:1] == b"S":  # bytes, and all that one does to a database
            contribution = bytearray(original)
            for _ in range(draw.choice((1, 1, 3, 50))):
                contribution[draw.randrange(len(contribution))] = draw.randrange(256)
            yield bytes(
                contribution[
                    : draw.choice((len(contribution), draw.randrange(len(contribution) + 1)))
                ]
            )
        elif kind < 0.5:
            at, n = draw.randrange(len(original)), draw.choice((1, 20, 2000))
            piece = draw.choice(
                (original[at : at + n], b"\x1b[31m" * 3, b"9" * n, "\u202e".encode())
            )
            yield original[:at] + piece + original[at + draw.choice((0, n)) :]
        else:
            yield _otherwise(draw, original)


def _otherwise(draw: random.Random, original: bytes) -> bytes:
    """A line of it with one value changed: JSON as JSON, else a word, a cell or a number."""
    lines = original.splitlines(keepends=True)
    whole = original.startswith(b"{") and len(lines) < 40 and not original.startswith(b'{"event"')
    at = draw.randrange(len(lines))
    try:
        value = json.loads(original if whole else lines[at])
        holder = value
        while True:
            place = draw.choice(list(holder) if isinstance(holder, dict) else range(len(holder)))
            if not (
                isinstance(holder[place], dict | list) and holder[place] and draw.random() < 0.7
            ):
                break
            holder = holder[place]
        what = draw.randrange(4)
        if what == 0:
            del holder[place]
        elif what == 1:
            holder[place] = draw.choice(NUMBERS)
        elif what == 2:
            holder[place] = draw.choice(TEXTS)
        else:
            holder[place] = draw.choice(([], [holder[place]] * 3, {"a": 1}, [[]]))
        changed = json.dumps(value).encode() + b"\n"
        if whole:
            return changed
        lines[at] = changed
    except (ValueError, TypeError, IndexError):
        words = lines[at].replace(b",", b" , ").replace(b"=", b" = ").split(b" ")
        new = draw.choice((*map(repr, NUMBERS), *TEXTS, "nan", "inf", "[[", '"', "-1", "1e999"))
        words[draw.randrange(len(words))] = new.encode()
        lines[at] = b" ".join(words).rstrip(b"\n") + b"\n"
    return b"".join(lines)


def fuzz(
    run: Path, name: str, count: int, seed: int, until: float = float("inf")
) -> tuple[int, list[str]]:
    """How many mutants of one file were tried, and what went wrong, in a line each."""
    target = TARGETS[name]
    wrong: list[str] = []
    original = (run / target.file).read_bytes()
    tried = 0
    for tried, content in enumerate(mutants(seed, original, name), start=1):
        (run / target.file).write_bytes(content)
        problem = _read(target, run)
        if problem:
            wrong.append(f"{name}, mutant {tried} of seed {seed}: {problem}")
        if tried >= count or time.monotonic() > until or len(wrong) >= 5:
            break
    (run / target.file).write_bytes(original)
    return tried, wrong


def _read(target: Target, run: Path) -> str:
    """What was wrong with the answer; empty where nothing was."""
    out, err = io.StringIO(), io.StringIO()
    began = time.monotonic()
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = target.read(run)
    except BaseException as error:
        return f"raised {type(error).__name__}: {error}"
    told = err.getvalue()
    if code not in (0, 1, 2):
        return f"exit code {code}"
    if "wyner: unexpected" in told or "Traceback" in told:
        return f"exit code {code}: {told[:300]}"
    if code == 2 and not told.strip():
        return "exit code 2 without a word"
    shown = (out.getvalue() + told).splitlines()
    if not all(line.isprintable() for line in shown):
        return f"unprintable: {next(line for line in shown if not line.isprintable())[:200]!r}"
    if len(told) > 20_000:
        return f"{len(told)} characters of errors"
    if time.monotonic() - began > SECONDS:
        return f"took {time.monotonic() - began:.0f} s"
    return ""


def main(argv: list[str] | None = None) -> int:
    """Fuzz every file; 1 when something went wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=2000, help="mutants of each file")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="for each file")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--of", default=",".join(TARGETS), help="of these")
    parser.add_argument("--results", type=Path, default=Path("campaign-files.json"))
    args = parser.parse_args(argv)
    told: dict[str, Any] = {"version": code_version()}
    failed = 0
    with tempfile.TemporaryDirectory() as folder:
        run = Path(folder) / "run"
        with contextlib.redirect_stdout(io.StringIO()):
            lay_out(run)
        for name in args.of.split(","):
            before = megabytes()
            tried, wrong = fuzz(run, name, args.count, args.seed, time.monotonic() + args.seconds)
            failed += len(wrong)
            told[name] = {
                "mutants": tried,
                "wrong": wrong,
                "grown_mb": round(megabytes() - before, 1),
            }
            print(f"{name}: {told[name]}", file=sys.stderr)
    write_atomically(args.results, json.dumps(told, indent=1).encode())
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
