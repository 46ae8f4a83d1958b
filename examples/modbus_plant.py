"""A device behind Modbus TCP as a plant: input and level are registers in thousandths.

``ModbusTank`` is the adapter, all that a device needs: start, apply, sample, safe, close. In a
scenario it stands as ``kind = "python"``, ``object = "modbus_plant.py:ModbusTank"``, and runs at
``--pace realtime``. Here it is tried against a device that is simulated on this machine and makes a
step with each write.
"""

import socketserver
import struct
import threading
import time

from pymodbus.client import ModbusTcpClient

from wyner import Sample, build, run

PORT = 15020
PUMP, LEVEL, SAFE = 0, 1, 2
"""Addresses of the holding registers."""


class ModbusTank:
    """A tank's level (m), by the flow of a pump (l/s); both signed, in thousandths."""

    def __init__(self, host: str = "127.0.0.1", port: int = PORT) -> None:
        self.client = ModbusTcpClient(host, port=port, timeout=1.0)

    def start(self, seed: int | None) -> Sample:  # noqa: ARG002
        """Connect and read."""
        if not self.client.connect():
            raise ConnectionError("no Modbus device answers")
        self.client.write_register(SAFE, 0)
        self.apply((0.0,))
        return self.sample()

    def apply(self, u: tuple[float, ...]) -> None:
        """Write the pump's flow; the device goes on by itself."""
        answer = self.client.write_register(PUMP, round(u[0] * 1000) & 0xFFFF)
        if answer.isError():
            raise OSError(f"the pump refused {u[0]:.3f}")

    def sample(self) -> Sample:
        """Read the level, with the time of the reading: a repeated one is no reading."""
        answer = self.client.read_holding_registers(LEVEL, count=1)
        if answer.isError():
            raise OSError("the level cannot be read")
        (raw,) = struct.unpack(">h", struct.pack(">H", answer.registers[0]))
        return Sample((raw / 1000,), time.monotonic_ns())

    def safe(self) -> None:
        """Stop the pump; the device has a watchdog of its own for when this cannot be said."""
        self.client.write_register(SAFE, 1)

    def close(self) -> None:
        """Disconnect."""
        self.client.close()


class SimulatedDevice(socketserver.ThreadingTCPServer):
    """As much of Modbus TCP as the adapter speaks: functions 3 and 6, three registers."""

    allow_reuse_address = True
    daemon_threads = True
    level = 0.0
    registers = [0, 0, 0]  # noqa: RUF012

    def write(self, address: int, value: int) -> None:
        """Take a value; a written pump moves the water."""
        self.registers[address] = value
        if address == PUMP and not self.registers[SAFE]:
            (flow,) = struct.unpack(">h", struct.pack(">H", value))
            self.level = 0.9 * self.level + 0.5 * flow / 1000
            self.registers[LEVEL] = round(self.level * 1000) & 0xFFFF


class Handler(socketserver.BaseRequestHandler):
    """One connection."""

    def handle(self) -> None:
        """Answer until the client goes away."""
        server = self.server
        assert isinstance(server, SimulatedDevice)
        while head := self.request.recv(7):
            number, _, length, unit = struct.unpack(">HHHB", head)
            body = self.request.recv(length - 1)
            function, address, value = struct.unpack(">BHH", body[:5])
            if function == 6:
                server.write(address, value)
                answer = body
            else:
                found = server.registers[address : address + value]
                answer = struct.pack(f">BB{value}H", 3, 2 * value, *found)
            self.request.sendall(struct.pack(">HHHB", number, 0, len(answer) + 1, unit) + answer)


SCENARIO = {
    "name": "modbus-tank",
    "plant": {
        "kind": "python",
        "object": "modbus_plant.py:ModbusTank",
        "period_s": 0.5,
        "disturbance": {"enters": "none"},
    },
    # rounding to thousandths is all that disturbs this tank; a real one is fitted with wyner fit
    "defender": {"A": [[0.9]], "B": [[0.5]], "disturbance": {"half_widths": [0.002]}},
    "control": {
        "law": "packed",
        "horizon": 5,
        "inputs": {"half_widths": [1.0]},
        "gain": [[-0.5]],
    },
    "secrecy": {"alpha": 8.0, "candidates": 2},
}

if __name__ == "__main__":
    with SimulatedDevice(("127.0.0.1", PORT), Handler) as device:
        threading.Thread(target=device.serve_forever, daemon=True).start()
        runs = run(build(SCENARIO), steps=300, seed=1, message=b"tank", plant=ModbusTank())
        device.shutdown()
    tested = int((runs.message_symbol < 0).sum())
    print(f"{runs.agreements[0]} of {tested} tested steps agreed; recovered {runs.messages[0]}")
