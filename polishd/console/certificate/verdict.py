"""Whether a part is what its drawing wants, by which line, and how sure that is: from the last map's judgement."""

from __future__ import annotations

from collections.abc import Iterator

from polishd.config.profile import InstrumentProfile
from polishd.console.certificate.model import CertificateVerdict, Judgement, State, Uncertainty
from polishd.console.certificate.sources import CertificateRun
from polishd.model.tolerance import Judged, holds, judged_of, worst
from polishd.show import words
from polishd.show.words import VERDICTS


def verdict_of(run: CertificateRun) -> CertificateVerdict:
    """By the lines of the last map. Where a pass touched the part since, nobody knows."""
    judged, outcome = judged_of(run.rows.maps[-1]["stats"]), words.text(run.folder.summary.get("outcome"))
    since = [done for done in run.rows.passes if done["cycle"] >= run.rows.maps[-1]["cycle"]]
    state: State = "not known" if since or not judged else "in tolerance" if holds(judged) else "not in tolerance"
    farthest = worst(judged)
    ended = VERDICTS[outcome].words if outcome in VERDICTS else outcome.replace("_", " ")
    if since:
        said = "Not known: the part was polished after its last map"
    elif not judged:
        said = "Not known: the job judges no line"
    elif state == "in tolerance":
        said = f"In tolerance: {len(judged)} of {len(judged)} lines hold"
    else:
        said = f"Not in tolerance: {sum(one.holds for one in judged)} of {len(judged)} lines hold"
    unsure = sum(one.unsure for one in judged)
    if unsure and state != "not known":
        said += f"; of {unsure} the limit lies within its uncertainty"
    return CertificateVerdict(
        state=state,
        words=said,
        decided_by="" if farthest is None else str(farthest),
        lines=[Judgement.model_validate(one.facts()) for one in judged],
        unsure_lines=unsure,
        outcome=ended if outcome else "unfinished",
        final=run.rows.job["ended"] is not None,
    )


def uncertainty_of(run: CertificateRun, profile: InstrumentProfile | None) -> Uncertainty:
    """What is known of the error of the figures that decide, in sentences."""
    accepted = words.text(run.folder.summary.get("accept")) or "figure"
    judged = judged_of(run.rows.maps[-1]["stats"])
    return Uncertainty.model_validate(
        {"accepted": accepted, "statements": [*_of_lines(judged), *_of_instrument(run, profile)]}
    )


def _of_lines(judged: tuple[Judged, ...]) -> Iterator[str]:
    """What the table of the lines does not say by itself."""
    for one in judged:
        if one.bound is not None:
            yield f"{one.what}: {one.bound_words}; judged by that bound."
        elif one.unsure:
            sigma = f"{one.value:.3g} ± {one.uncertainty:.2g} {one.unit}"
            yield f"{one.what}: {sigma}, and the limit lies within that: either verdict is possible."
    plain = [one.what for one in judged if one.bound is None and one.uncertainty is None]
    if plain:
        yield f"Judged as measured, with an uncertainty that is not known: {', '.join(plain)}."
    if any(one.bound is None and one.uncertainty is not None for one in judged):
        yield "± is by the instrument's repeatability alone, at most."


def _of_instrument(run: CertificateRun, profile: InstrumentProfile | None) -> Iterator[str]:
    repeats = None if profile is None else profile.instrument.repeatability_nm
    if repeats is None:
        yield "The instrument's repeatability is not in its profile."
    else:
        yield f"The instrument's repeatability is {repeats:g} nm RMS."
    if run.rows.maps[-1]["stats"].get("system"):
        yield "The instrument's own error was told by turning a part, and is off each map."
    else:
        yield "The instrument's own error has not been told apart from the part's: it is in all figures."
