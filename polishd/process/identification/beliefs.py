"""What is known of a machine as the record that a job keeps, and as the knowledge that the next pass begins with."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from polishd.model.beliefs import Estimate, MachineEstimates
from polishd.model.errors import ComputeError
from polishd.model.surface import FloatArray
from polishd.process.identification.comparison import conditioned, without
from polishd.process.identification.parameters import PriorKnowledge, advanced, unlearned, usual_parameters


def knowledge_of(beliefs: MachineEstimates, *, turns: bool) -> PriorKnowledge:
    """As the next pass's prior (`usual_parameters`); ComputeError where another polishd kept other parameters."""
    known = unlearned(usual_parameters(turns=turns))
    if not beliefs.mean:
        return known
    if tuple(beliefs.mean) != known.names:
        raise ComputeError(
            f"what was kept of the machine has the parameters {', '.join(beliefs.mean)}, and this polishd knows "
            f"{', '.join(known.names)}: finish the job with the polishd that began it, or give job.id a new name"
        )
    return PriorKnowledge(
        known.parameters, np.array(list(beliefs.mean.values())), np.array(beliefs.covariance), dict(beliefs.odds)
    )


def on_the_next_part(beliefs: MachineEstimates, days: float) -> MachineEstimates:
    """What a job begins with, so many days after the pass that taught it: what belongs to a mounted part is forgotten.

    ComputeError as of `knowledge_of`.
    """
    known = knowledge_of(beliefs, turns="turn" in beliefs.mean)
    if not beliefs.mean:
        return beliefs
    after = advanced(known, 0.0, max(days, 0.0), anew=("mount",))
    of_part = {p.name for p in known.parameters if p.scope in {"map", "mount"}}
    walked = known.parameters[known.at("rate")].rest * max(days, 0.0) ** 0.5
    sigma = None if beliefs.rate.sigma is None else float(np.hypot(beliefs.rate.sigma, beliefs.rate.value * walked))
    rate = replace(beliefs.rate, sigma=sigma)
    return replace(
        beliefs,
        rate=rate,
        applied={name: value for name, value in beliefs.applied.items() if name not in of_part},
        mean=dict(zip(after.names, after.mean.tolist(), strict=True)),
        covariance=tuple(tuple(row) for row in after.covariance.tolist()),
    )


def beliefs_of(
    learned: PriorKnowledge, taken: Iterable[str], contact_h: float, rates: tuple[float, float], volume: FloatArray
) -> MachineEstimates:
    """What is believed after a pass of so many hours in contact.

    Args:
        learned: by the pass.
        taken: extensions that plans are to count with; the others' parameters are 0 then, and the rest follows.
        contact_h: of the pass.
        rates: least and largest rate that may be believed.
        volume: (k,) of `Identified`: the rate's stated error is that of all that the next pass removes.

    The next pass may be another program's: on the tracks of a first touch rate and field cancel, over a part they do
    not. So the stated error is that of an even pass, too, with all extensions in, and what leaving some out has moved.
    """
    out = without(learned.parameters, frozenset(taken))
    mean, covariance = conditioned(learned.mean, learned.covariance, out)
    known = advanced(learned, contact_h)
    plan = advanced(PriorKnowledge(learned.parameters, mean, covariance), contact_h)
    applied = {
        p.name: float(value)
        for p, value in zip(plan.parameters, plan.mean, strict=True)
        if p.extension is not None and p.extension in taken
    }
    rate = plan.at("rate")
    value = float(np.clip(np.exp(plan.mean[rate]), *rates))
    even = np.where([name.startswith("field_") for name in known.names], 0.0, volume)
    moved = float(even @ (mean - learned.mean))
    sigma = max(np.sqrt(volume @ plan.covariance @ volume), np.hypot(np.sqrt(even @ known.covariance @ even), moved))
    return MachineEstimates(
        rate=Estimate(value, value * float(sigma)),
        applied=applied,
        mean=dict(zip(known.names, known.mean.tolist(), strict=True)),
        covariance=tuple(tuple(row) for row in known.covariance.tolist()),
        odds=dict(known.odds),
        pass_h=contact_h,
    )
