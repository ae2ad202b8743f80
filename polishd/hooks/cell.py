"""A cell's file with the plugins that it names."""

from __future__ import annotations

from pathlib import Path

from polishd.config.cell import CellConfig, load_config
from polishd.hooks.loader import Hooks, load_plugins


def plugins_of(config: CellConfig) -> Hooks:
    """The plugins that a config names; what is refused is in the report."""
    return load_plugins(config.plugins.load, config.dialect_paths)


def load_cell(cell: Path, correction: str | None = None) -> tuple[CellConfig, Hooks]:
    """Config and plugins; ConfigError or PluginError where anything that the config names is missing or broken."""
    config = load_config(cell, {"process.correction": correction} if correction else None)
    hooks = plugins_of(config)
    hooks.report.require()
    return config, hooks


def hooks_of_job(cell: CellConfig, hooks: Hooks, job: CellConfig) -> Hooks:
    """The cell's plugins for a job that is laid over it: with dialects of its own, where it names any."""
    if job.dialect_paths == cell.dialect_paths:
        return hooks
    found = plugins_of(job)
    found.report.require()
    return found
