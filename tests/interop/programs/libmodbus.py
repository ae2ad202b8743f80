"""libmodbus itself, through ctypes: a master, and as a process (a slave) what serves its mapping.

``python libmodbus.py tcp`` listens on loopback at any port, ``python libmodbus.py rtu PATH`` on a serial line at 19200
8N1. The first line has its address; then each line of JSON sets or gets values of a table.
"""

from __future__ import annotations

import ctypes
import json
import os
import sys
import threading
from collections.abc import Sequence

SIZE = 200
MAX_ADU = 260
TABLES = {"coil": 0, "discrete": 1, "input": 2, "holding": 3}
SECONDS = 10
ENOBASE = 112345678
"""libmodbus numbers exceptions of a device from here on."""


class Mapping(ctypes.Structure):
    """Structure ``modbus_mapping_t`` of ``modbus.h``."""

    _fields_ = (
        *((name, ctypes.c_int) for name in ("nb_bits", "start_bits", "nb_input_bits", "start_input_bits")),
        *((name, ctypes.c_int) for name in ("nb_input", "start_input", "nb_registers", "start_registers")),
        *((name, ctypes.POINTER(ctypes.c_uint8)) for name in ("bits", "input_bits")),
        *((name, ctypes.POINTER(ctypes.c_uint16)) for name in ("inputs", "registers")),
    )


def library() -> ctypes.CDLL:
    """With the types that are no int."""
    lib = ctypes.CDLL("libmodbus.so.5", use_errno=True)
    for name in ("modbus_new_tcp", "modbus_new_rtu"):
        getattr(lib, name).restype = ctypes.c_void_p
    lib.modbus_new_rtu.argtypes = (ctypes.c_char_p, ctypes.c_int, ctypes.c_char, ctypes.c_int, ctypes.c_int)
    lib.modbus_mapping_new.restype = ctypes.POINTER(Mapping)
    return lib


class Client:
    """A master; ``read`` and ``write`` return an exception code where the device answers so."""

    def __init__(self, *, tcp: tuple[str, int] | None = None, path: str = "", baud: int = 0) -> None:
        self._lib = library()
        made = (
            self._lib.modbus_new_tcp(tcp[0].encode(), tcp[1])
            if tcp
            else self._lib.modbus_new_rtu(path.encode(), baud, b"N", 8, 1)
        )
        self._context = ctypes.c_void_p(made)
        self._lib.modbus_set_slave(self._context, 1)
        self._lib.modbus_set_response_timeout(self._context, SECONDS, 0)
        if self._lib.modbus_connect(self._context):
            raise OSError(ctypes.get_errno(), "libmodbus cannot connect")

    def close(self) -> None:
        """And free it."""
        self._lib.modbus_close(self._context)
        self._lib.modbus_free(self._context)

    def read(self, table: str, address: int, count: int) -> list[int] | int:
        """Words, or bits as 0 and 1."""
        kind = ctypes.c_uint8 if table in {"coil", "discrete"} else ctypes.c_uint16
        found = (kind * count)()
        names = {"coil": "bits", "discrete": "input_bits", "holding": "registers", "input": "input_registers"}
        done = getattr(self._lib, f"modbus_read_{names[table]}")(self._context, address, count, found)
        return list(found) if done == count else self._refusal()

    def write(self, table: str, address: int, values: Sequence[int]) -> int:
        """0 where it was taken."""
        name = {"coil": "bit", "holding": "register"}[table]
        if len(values) == 1:
            done = getattr(self._lib, f"modbus_write_{name}")(self._context, address, values[0])
        else:
            kind = ctypes.c_uint8 if table == "coil" else ctypes.c_uint16
            many = (kind * len(values))(*values)
            done = getattr(self._lib, f"modbus_write_{name}s")(self._context, address, len(values), many)
        return 0 if done == len(values) else self._refusal()

    def _refusal(self) -> int:
        code = ctypes.get_errno() - ENOBASE
        if not 0 < code < 12:
            raise OSError(ctypes.get_errno(), "libmodbus has no answer")
        return code


def serve(arguments: Sequence[str]) -> None:
    """Run until standard input ends."""
    lib = library()
    mapping = lib.modbus_mapping_new(SIZE, SIZE, SIZE, SIZE)
    tcp = arguments[0] == "tcp"
    made = lib.modbus_new_tcp(b"127.0.0.1", 0) if tcp else lib.modbus_new_rtu(arguments[1].encode(), 19200, b"N", 8, 1)
    context = ctypes.c_void_p(made)
    lib.modbus_set_slave(context, 1)
    where: int | str = arguments[-1]
    listening = ctypes.c_int(-1)
    if tcp:
        listening = ctypes.c_int(lib.modbus_tcp_listen(context, 5))
        where = socket_port(listening.value)
    else:
        lib.modbus_connect(context)
    threading.Thread(target=answer, args=(lib, context, mapping, listening), daemon=True).start()
    print(json.dumps({"ok": where}), flush=True)
    for line in sys.stdin:
        print(json.dumps({"ok": changed(mapping.contents, json.loads(line))}), flush=True)
    os._exit(0)


def answer(lib: ctypes.CDLL, context: ctypes.c_void_p, mapping: object, listening: ctypes.c_int) -> None:
    """Each request of each connection, one after the other."""
    request = (ctypes.c_uint8 * MAX_ADU)()
    while True:
        if listening.value >= 0:
            lib.modbus_tcp_accept(context, ctypes.byref(listening))
        while (size := lib.modbus_receive(context, request)) >= 0:
            if size:
                lib.modbus_reply(context, request, size, mapping)
        lib.modbus_close(context)
        if listening.value < 0:
            lib.modbus_connect(context)


def changed(mapping: Mapping, question: dict[str, list[object]]) -> list[int]:
    """What stands in a table, after ``set`` where there is such a thing."""
    tables = (mapping.bits, mapping.input_bits, mapping.inputs, mapping.registers)
    table, address, what = question.get("set") or question["get"]
    cells, at = tables[TABLES[str(table)]], int(str(address))
    if isinstance(what, list):
        for k, value in enumerate(what):
            cells[at + k] = value
        return what
    return [cells[at + k] for k in range(int(str(what)))]


def socket_port(descriptor: int) -> int:
    """That a listening socket has got."""
    import socket

    with socket.socket(fileno=os.dup(descriptor)) as listening:
        return int(listening.getsockname()[1])


if __name__ == "__main__":
    serve(sys.argv[1:])
