"""Devices as their types build them, and held against what their ports ask. Opens nothing."""

from __future__ import annotations

from typing import Any

from polishd.config.cell import CellConfig, PortSection, device_options
from polishd.daemon.port_checks import lacking
from polishd.hooks.loader import Hooks
from polishd.hookspecs import DeviceContext
from polishd.model.errors import ConfigError, PluginError, PolishdError
from polishd.ports.devices import Device, ForceActuator, Metrology, Robot, Spindle

PORTS: dict[PortSection, type] = {
    "robot": Robot,
    "actuator": ForceActuator,
    "spindle": Spindle,
    "metrology": Metrology,
}


def built(config: CellConfig, hooks: Hooks, section: PortSection, context: DeviceContext) -> Device:
    """The device of a section, with all that its port asks.

    Raises:
        ConfigError: the section is wrong; names file, line and key.
        PluginError: the device's plugin is: it raises something else, or the device lacks what the port asks.
    """
    kind, options = device_options(config, section, hooks.device_types())
    try:
        device = kind.build(options, context)
    except ConfigError as error:
        raise config.error(_blamed(section, options, str(error)), str(error)) from error
    except PolishdError:
        raise
    except Exception as error:  # a plugin may raise anything at all
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        raise _broken(config, hooks, section, f"cannot be built: {reason}") from error
    port = PORTS[section]
    if lacks := lacking(device, port):
        raise _broken(config, hooks, section, f"{type(device).__name__} is no {port.__name__}: {'; '.join(lacks)}")
    return device


def _blamed(section: PortSection, options: Any, problem: str) -> str:
    """The key whose value the problem quotes; the section's where it quotes none."""
    quoted = (key for key, value in options if isinstance(value, str) and repr(value) in problem)
    return ".".join([section, *list(quoted)[:1]])


def _broken(config: CellConfig, hooks: Hooks, section: PortSection, what: str) -> PluginError:
    name = getattr(config, section).type
    plugin = hooks.plugin_of("polishd_device_types", name)
    problem = f"plugin {plugin!r}, device type {name!r}: {what}; mend the plugin (nothing was opened)"
    return PluginError(config.source.error((section, "type"), problem))
