"""What an event is; its kinds are in ``events``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, is_dataclass
from typing import Annotated, Any, ClassVar

from polishd.model.concern import OperatorNotice


@dataclass(frozen=True, slots=True, kw_only=True)
class Event:
    """Something that happened. Each kind is a class of its own, known by ``name``."""

    name: ClassVar[str]
    cycle: Annotated[int | None, "the cycle in which it happened; None outside of all"] = None

    @property
    def data(self) -> Mapping[str, Any]:
        """Its own fields by name, as the socket and the journal have them; those of a record or mapping one by one."""
        found: dict[str, Any] = {}
        for name in (item.name for item in fields(self) if item.name != "cycle"):
            value = _plain(getattr(self, name))
            found |= value if isinstance(value, Mapping) else {name: value}
        return found

    def facts(self) -> dict[str, Any]:
        """``{"name", "cycle", "data"}``, as a subscriber gets it."""
        return {"name": self.name, "cycle": self.cycle, "data": dict(self.data)}

    def concern(self) -> OperatorNotice | None:
        """Nobody's."""
        return None


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(one) for key, one in value.items()}
    return asdict(value) if is_dataclass(value) and not isinstance(value, type) else value
