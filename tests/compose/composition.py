"""One composition under test: brought up, looked into, disturbed, and taken down."""

import base64
import json
import os
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
BASE_IMAGE = "wyner-base:local"
"""Made by deploy/base-image; used when it is there and the environment names no other."""

RUN = "/var/lib/wyner/run"

PACE = "x5"
"""Fifty steps a second: a loaded machine keeps it too, and so does a tap that decodes."""

SYMBOLS_BEFORE = 20
"""So many symbols of a message have crossed before a test calls it under way."""

PATIENCE_S = 300.0
"""How long a test waits for what has to come, however slow the machine is."""


def docker(*arguments: str) -> str:
    """Run the client and return what it printed."""
    done = subprocess.run(
        ["docker", *arguments], check=True, capture_output=True, text=True, timeout=PATIENCE_S
    )
    return done.stdout


def base_image() -> str | None:
    """The base to build on; None for the Dockerfile's own."""
    if os.environ.get("BASE_IMAGE"):
        return os.environ["BASE_IMAGE"]
    return BASE_IMAGE if docker("images", "--quiet", BASE_IMAGE).strip() else None


def leftovers(project: str) -> list[str]:
    """Containers, networks and volumes that still bear a project's label."""
    label = f"label=com.docker.compose.project={project}"
    return [
        f"{kind} {name}"
        for kind, command in (
            ("container", ("ps", "--all", "--quiet")),
            ("network", ("network", "ls", "--quiet")),
            ("volume", ("volume", "ls", "--quiet")),
        )
        for name in docker(*command, "--filter", label).split()
        if not (kind == "network" and miscounted(name))
    ]


def miscounted(network: str) -> bool:
    """Whether the engine believes in endpoints of a network in which it knows no container.

    Docker 20.10 now and then loses count when containers come and go at the same time
    (github.com/moby/moby/issues/42119); until it is restarted nobody can remove the network.
    """
    inside = docker("network", "inspect", "--format", "{{len .Containers}}", network).strip()
    attempt = subprocess.run(
        ["docker", "network", "rm", network],
        capture_output=True, text=True, timeout=PATIENCE_S, check=False,
    )  # fmt: skip
    return inside == "0" and "has active endpoints" in attempt.stderr


class Composition:
    """The compose file of this project, under a project name and a profile of its own."""

    image = "wyner:test"

    def __init__(
        self, project: str, profile: str = "direct", variables: Mapping[str, str] | None = None
    ) -> None:
        self.project = project
        self.profile = profile
        self.environment = {**os.environ, **(variables or {})}
        self.environment["WYNER_IMAGE"] = self.image
        base = base_image()
        if base is not None:
            self.environment["BASE_IMAGE"] = base
        self._containers: dict[str, str] = {}

    def command(self, *arguments: str) -> list[str]:
        """The command line of one call."""
        # Named here, so that a file of the user's beside compose.yaml changes nothing.
        options = ["-f", "compose.yaml", "-p", self.project, "--profile", self.profile]
        return ["docker", "compose", *options, *arguments]

    def compose(
        self, *arguments: str, check: bool = True, timeout: float = PATIENCE_S
    ) -> subprocess.CompletedProcess[str]:
        """Run ``docker compose``."""
        return subprocess.run(
            self.command(*arguments),
            cwd=ROOT,
            env=self.environment | {"COMPOSE_PROGRESS": "plain"},
            capture_output=True,
            text=True,
            stdin=subprocess.DEVNULL,
            timeout=timeout,
            check=check,
        )

    def up(self, *arguments: str) -> None:
        """Start everything."""
        self._containers.clear()  # what has changed is made anew
        started = self.compose("up", "--detach", "--no-build", *arguments, check=False)
        assert started.returncode == 0, started.stderr[-3000:]

    def down(self) -> None:
        """Take everything down, volumes too: all profiles, for `run` makes networks of them all.

        The containers go one by one, which keeps older engines from losing count (`miscounted`).
        """
        self._containers.clear()
        every = Composition(self.project, "*", self.environment)
        for container in every.compose("ps", "--all", "--quiet").stdout.split():
            docker("rm", "--force", container)
        ended = every.compose("down", "--volumes", "--timeout", "5", check=False)
        assert ended.returncode == 0 or "has active endpoints" in ended.stderr, ended.stderr

    def container(self, service: str) -> str:
        """The id of a service's container, running or not."""
        if service not in self._containers:
            label = "label=com.docker.compose"
            self._containers[service] = docker(
                "ps", "--all", "--quiet", "--filter", f"{label}.project={self.project}",
                "--filter", f"{label}.service={service}", "--filter", f"{label}.oneoff=False",
            ).split()[0]  # fmt: skip
        return self._containers[service]

    def inspect(self, service: str) -> dict[str, Any]:
        """What the engine says of a service's container."""
        return self.inspect_all([service])[0]

    def inspect_all(self, services: Sequence[str]) -> list[dict[str, Any]]:
        """What the engine says of the services' containers, asked once."""
        containers = map(self.container, services)
        found: list[dict[str, Any]] = json.loads(docker("inspect", *containers))
        return found

    def healthy(self, services: Sequence[str]) -> bool:
        """Whether the engine calls all of them so, and none starting or unhealthy."""
        states = [container["State"] for container in self.inspect_all(services)]
        return all(state["Health"]["Status"] == "healthy" for state in states)

    def told(self, service: str) -> str:
        """A service's state, its health and what its last check said, in a line."""
        try:
            state = self.inspect(service)["State"]
            health = state["Health"]
            last = health["Log"][-1]["Output"].strip() if health["Log"] else "not checked yet"
            return f"{service}: {state['Status']}, {health['Status']}: {last}"
        except (subprocess.CalledProcessError, LookupError) as error:
            return f"{service}: {error!r}"

    def execute(
        self, service: str, *command: str, stdin: str = "", check: bool = True
    ) -> subprocess.CompletedProcess[str]:
        """Run a command in a service's container."""
        return subprocess.run(
            ["docker", "exec", "--interactive", self.container(service), *command],
            input=stdin,
            capture_output=True,
            text=True,
            timeout=PATIENCE_S,
            check=check,
        )

    def python(
        self, service: str, program: str, *arguments: str, check: bool = True
    ) -> subprocess.CompletedProcess[str]:
        """Run a Python program in a service's container."""
        return self.execute(service, "python", "-", *arguments, stdin=program, check=check)

    def status(self, service: str, vantage: str) -> dict[str, Any]:
        """The newest status that a controller or plant wrote."""
        path = f"{RUN}/{vantage}/status.json"
        status: dict[str, Any] = json.loads(self.execute(service, "cat", path).stdout)
        return status

    def recovered(self, plant: str) -> list[str]:
        """All messages that the plant has recovered, in order, from its trace."""
        path = f"{RUN}/plant/trace.jsonl"
        read = self.execute(plant, "grep", '"event":"recovered"', path, check=False)
        events = [json.loads(line) for line in read.stdout.splitlines()]
        return [base64.b64decode(event["payload"]).decode() for event in events]

    def send(self, text: str) -> None:
        """Hand the controller a message, as an operator does."""
        self.compose("run", "--rm", "--no-deps", "operator", "send", text)

    def kill(self, service: str) -> None:
        """SIGKILL a service's process from outside, as the kernel would when memory runs out.

        (`docker kill` counts as a wish, which the restart policy respects.)
        """
        victim = self.inspect(service)["State"]["Pid"]
        docker(
            "run", "--rm", "--network=none", "--pid=host", "--user=0", "--cap-drop=ALL",
            "--cap-add=KILL", "--entrypoint=sh", self.image, "-c", f"kill -9 {victim}",
        )  # fmt: skip


def wait_for(
    condition: Callable[[], Any], what: str, told: Callable[[], str] = str, every_s: float = 1.0
) -> Any:
    """The condition's first true value; where there is none in time, it fails with what is told."""
    until = time.monotonic() + PATIENCE_S
    while True:
        try:
            value = condition()
        except (subprocess.CalledProcessError, ValueError, LookupError):
            value = None  # a container that starts or restarts right now
        if value:
            return value
        assert time.monotonic() < until, f"not within {PATIENCE_S:g} s: {what}\n{told()}"
        time.sleep(every_s)  # each question starts programs


def arrives(system: Composition, plant: str, text: str) -> None:
    """Wait until the plant has recovered a message."""
    wait_for(lambda: text in system.recovered(plant), f"{text!r} recovered")


def all_healthy(system: Composition, services: Sequence[str]) -> None:
    """Wait until the engine calls every service healthy."""
    wait_for(
        lambda: system.healthy(services),
        f"{', '.join(services)} healthy",
        lambda: "\n".join(map(system.told, services)),
    )


def advancing(system: Composition, plant: str = "plant") -> None:
    """Wait until the plant counts transitions: sooner known than the engine's word on health."""
    first = wait_for(
        lambda: system.status(plant, "plant")["step"]["transitions"] + 1,
        "a status",
    )
    wait_for(lambda: system.status(plant, "plant")["step"]["transitions"] > first, "transitions")


def under_way(
    system: Composition, text: str, service: str = "controller", vantage: str = "controller"
) -> dict[str, Any]:
    """Send a message; return the status once its first symbols have crossed, and the last have not.

    What an earlier test has sent comes first, and is waited for.
    """

    def idle() -> bool:
        frame = system.status(service, vantage)["frame"]
        return not frame["queue"] and frame["symbols"] == frame["length"]

    wait_for(idle, "all that was sent before, delivered")
    system.send(text)
    begun: dict[str, Any] = wait_for(
        lambda: (
            SYMBOLS_BEFORE
            <= (s := system.status(service, vantage))["frame"]["symbols"]
            < s["frame"]["length"]
            and s
        ),
        f"{text!r} under way",
        every_s=0.2,
    )
    assert begun["frame"]["queue"] == 0
    return begun
