"""The power stage's state machine (CiA 402), by its numbered transitions. Pure."""

from __future__ import annotations

from dataclasses import dataclass

DISABLED, READY, ON, ENABLED, QUICK_STOP, REACTION, FAULT = range(7)
STATUS = (0x250, 0x231, 0x233, 0x237, 0x217, 0x21F, 0x218)
"""Low bits of the status word in each state, with voltage and remote; quick stop shows in bit 5."""


@dataclass(slots=True)
class Power:
    """What control words and events make of the state."""

    state: int = DISABLED
    control: int = 0
    quick_stop_option: int = 2

    @property
    def status(self) -> int:
        """State bits of the status word."""
        return STATUS[self.state]

    @property
    def live(self) -> bool:
        """The motor has current."""
        return self.state in {ENABLED, QUICK_STOP, REACTION}

    def command(self, word: int) -> None:
        """A control word was written. What is no command in this state changes nothing."""
        rises = word & ~self.control
        self.control = word
        if self.state == FAULT:
            if rises & 0x80:
                self.state = DISABLED
        elif self.state != REACTION:
            self.state = self._next(word)

    def fault(self) -> None:
        """Something is wrong: it is stopped, and then in fault."""
        if self.state != FAULT:
            self.state = REACTION if self.live else FAULT

    def stands(self) -> None:
        """The motor has come to rest."""
        if self.state == REACTION:
            self.state = FAULT
        elif self.state == QUICK_STOP and self.quick_stop_option <= 4:
            self.state = DISABLED

    def _next(self, word: int) -> int:
        if not word & 0x02:
            return DISABLED
        if not word & 0x04:
            stops = self.state in {ENABLED, QUICK_STOP} and self.quick_stop_option != 0
            return QUICK_STOP if stops else DISABLED
        low = word & 0x0F
        if self.state == QUICK_STOP:
            return ENABLED if low == 0x0F and self.quick_stop_option > 4 else QUICK_STOP
        if low == 0x06:  # shut down
            return READY
        if low == 0x07:  # switch on, or disable operation
            return self.state if self.state == DISABLED else ON
        if low == 0x0F:  # enable; from READY by way of ON, within one command as CiA 402 allows
            return ENABLED if self.state in {READY, ON, ENABLED} else self.state
        return self.state
