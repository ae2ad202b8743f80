"""Modbus requests of which each answer is checked. The only file that knows pymodbus."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable

from pymodbus.client import AsyncModbusSerialClient, AsyncModbusTcpClient
from pymodbus.exceptions import ConnectionException, ModbusException, ModbusIOException
from pymodbus.pdu import ExceptionResponse, ModbusPDU
from pymodbus.pdu.register_message import ReadInputRegistersResponse, WriteSingleRegisterResponse

from polishd.api import DeviceRefused, Identity, LinkError, ProtocolError
from polishd.drivers.transport.address import SerialLine, Tcp
from polishd.drivers.voice_coil import registers
from polishd.drivers.voice_coil.device import Reading


class ModbusWire:
    """A VoiceCoilWire over Modbus.

    On RTU an answer bears no number: one that comes after its time would be taken for the next request's. So after
    silence or nonsense the line is closed, and opened again (which drops what came) only when no answer can be due.
    """

    def __init__(self, address: Tcp | SerialLine, unit: int, silence_s: float) -> None:
        """An answer comes within ``silence_s``; on a serial line one may still come as long after that."""
        self.name = f"{address} unit {unit}"
        self._address = address
        self._unit = unit
        self._silence_s = silence_s
        self._client: AsyncModbusTcpClient | AsyncModbusSerialClient | None = None
        self._heartbeat = 0
        self._beaten = False
        self._due_until = 0.0

    @property
    def connected(self) -> bool:
        """See VoiceCoilWire."""
        return self._client is not None and self._client.connected

    async def connect(self) -> None:
        """See VoiceCoilWire."""
        await self.disconnect()
        if isinstance(self._address, SerialLine):
            await asyncio.sleep(max(self._due_until - time.monotonic(), 0.0))
        client = self._make()
        try:
            connected = await client.connect()
        except BaseException:
            client.close()
            raise
        if not connected:
            raise LinkError(f"{self.name}: cannot be opened")
        self._client = client

    async def disconnect(self) -> None:
        """See VoiceCoilWire."""
        client, self._client = self._client, None
        self._beaten = False
        if client is not None:
            client.close()

    async def identity(self) -> Identity:
        """See VoiceCoilWire."""
        return registers.identity(await self._read(*registers.IDENTITY))

    async def read(self) -> Reading:
        """See VoiceCoilWire. The echo of our heartbeat tells a fresh answer from a stale one."""
        reading, heartbeat = registers.reading(await self._read(*registers.INPUTS))
        if self._beaten and heartbeat != self._heartbeat:
            await self.disconnect()
            raise ProtocolError(f"{self.name}: heard heartbeat {heartbeat} where {self._heartbeat} was written last")
        return reading

    async def beat(self) -> None:
        """See VoiceCoilWire."""
        self._heartbeat = (self._heartbeat + 1) & 0xFFFF
        await self._write(registers.HEARTBEAT, self._heartbeat)
        self._beaten = True

    async def set_watchdog(self, watchdog_ms: int) -> None:
        """See VoiceCoilWire."""
        await self._write(registers.WATCHDOG, watchdog_ms)

    async def set_point(self, force_n: float) -> None:
        """See VoiceCoilWire."""
        await self._write(registers.SETPOINT, registers.setpoint_register(force_n))

    async def command(self, *, engage: bool) -> None:
        """See VoiceCoilWire."""
        await self._write(registers.COMMAND, registers.ENGAGE if engage else registers.RETRACT)

    def _make(self) -> AsyncModbusTcpClient | AsyncModbusSerialClient:
        if isinstance(self._address, Tcp):
            return AsyncModbusTcpClient(
                self._address.host, port=self._address.port, timeout=self._silence_s, retries=0, reconnect_delay=0
            )
        return AsyncModbusSerialClient(
            str(self._address.path), baudrate=self._address.baud, timeout=self._silence_s, retries=0, reconnect_delay=0
        )

    async def _read(self, address: int, count: int) -> list[int]:
        client = self._connected()
        answer = await self._answer(client.read_input_registers(address, count=count, device_id=self._unit))
        if not isinstance(answer, ReadInputRegistersResponse) or len(answer.registers) != count:
            raise await self._nonsense(f"read of {count} registers from {address}", answer)
        return list(answer.registers)

    async def _write(self, address: int, value: int) -> None:
        client = self._connected()
        answer = await self._answer(client.write_register(address, value, device_id=self._unit))
        echo = isinstance(answer, WriteSingleRegisterResponse) and (answer.address, list(answer.registers))
        if echo != (address, [value]):
            raise await self._nonsense(f"write of {value} to register {address}", answer)

    def _connected(self) -> AsyncModbusTcpClient | AsyncModbusSerialClient:
        if self._client is None:
            raise LinkError(f"{self.name}: is not open")
        return self._client

    async def _answer(self, request: Awaitable[ModbusPDU]) -> ModbusPDU:
        self._due_until = time.monotonic() + 2 * self._silence_s
        try:
            answer = await request
        except (ModbusIOException, ConnectionException, OSError) as error:
            await self.disconnect()
            raise LinkError(f"{self.name}: {error}") from error
        except ModbusException as error:
            await self.disconnect()
            raise ProtocolError(f"{self.name}: {error}") from error
        self._due_until = 0.0
        if isinstance(answer, ExceptionResponse):
            reason = registers.REFUSALS.get(answer.exception_code, "no reason that the map knows")
            raise DeviceRefused(f"{self.name}: exception {answer.exception_code}, {reason}")
        return answer

    async def _nonsense(self, what: str, answer: ModbusPDU) -> ProtocolError:
        self._due_until = time.monotonic() + 2 * self._silence_s
        await self.disconnect()
        return ProtocolError(f"{self.name}: the {what} was answered by {answer}")
