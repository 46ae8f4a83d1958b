"""The command: its options, and what it runs."""

from protocol.messages import Measurement
from protocol.topics import key_of
from runtime.bus_options import BusOptions, add_service_arguments, endpoints_of
from runtime.options import picked
from runtime.signals import stop_on_signals
from runtime.zenoh_bus import open_bus


def add_arguments(parser):
    """The options: where its buses are."""
    add_service_arguments(parser, "logger")


def run(args):
    """Print every measurement until a signal; returns the exit code."""

    def heard(_key, payload, _t_ns):
        print(payload.decode(), flush=True)

    ends = endpoints_of(picked(BusOptions, vars(args)), "logger")
    with stop_on_signals() as stopping, open_bus(ends["field"]) as field:
        field.subscribe(key_of(Measurement, args.loop), heard)
        stopping.wait()
    return 0
