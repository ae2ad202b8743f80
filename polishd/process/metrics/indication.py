"""What a drawing would have to allow for a surface to be within it, as ISO 10110-5 and -14 write it, in nm."""

from __future__ import annotations

from decimal import ROUND_CEILING, Context, Decimal

from polishd.process.metrics.iso10110 import Iso10110Figures

DIGITS = 3
REFLECTED = 2.0
"""The wavefront that is reflected once, at normal incidence, over the surface."""


def surface_form(found: Iso10110Figures) -> str:
    """``3/A(B/C)`` with RMSt, RMSi and RMSa of the surface, each rounded up: the surface is within it."""
    return _indication("3", found, 1.0)


def reflected_wavefront(found: Iso10110Figures) -> str:
    """``13/A(B/C)`` and its RMS figures of the wavefront that the surface reflects, rounded up likewise."""
    return _indication("13", found, REFLECTED)


def _indication(code: str, found: Iso10110Figures, times: float) -> str:
    a, b, c = (_up(times * value) for value in (found.a_nm, found.b_nm, found.c_nm))
    rms = {"t": found.rms_t_nm, "i": found.rms_i_nm, "a": found.rms_a_nm}
    return f"{code}/{a}({b}/{c}); " + "; ".join(f"RMS{name} < {_up(times * value)}" for name, value in rms.items())


def _up(value: float) -> str:
    """To ``DIGITS`` significant digits, never below the value, and never 0, which would be no limit."""
    rounded = Context(prec=DIGITS, rounding=ROUND_CEILING).create_decimal(repr(max(value, 1e-3)))
    return f"{max(rounded.quantize(Decimal('0.001'), rounding=ROUND_CEILING), Decimal('0.001')).normalize():f}"
