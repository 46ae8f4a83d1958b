"""The command: its options, and what it runs."""

from protocol.messages import Measurement
from protocol.topics import key_of
from runtime.bus_options import add_endpoint_arguments, endpoints_of
from runtime.signals import stop_on_signals
from runtime.zenoh_bus import open_bus


def add_arguments(parser):
    """The options: where its buses are."""
    add_endpoint_arguments(parser, "logger")


def run(args):
    """Print every measurement until a signal; returns the exit code."""

    def heard(_key, payload, _t_ns):
        print(payload.decode(), flush=True)

    with stop_on_signals() as stopping, open_bus(endpoints_of(args, "logger", "field")) as field:
        field.subscribe(key_of(Measurement, args.loop), heard)
        stopping.wait()
    return 0
