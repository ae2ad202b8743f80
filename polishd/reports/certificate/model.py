"""What a certificate says, as its twin holds it: docs/reference/certificate.schema.json is written from these models.

Numbers have their unit in their name. What is null is not known, or was not there; why, ``left_out`` says.
"""

from __future__ import annotations

from datetime import datetime
from typing import Any, Final, Literal

from pydantic import BaseModel, ConfigDict, Field

SCHEMA: Final = "polishd-certificate-1"
State = Literal["in tolerance", "not in tolerance", "not known"]


class Facts(BaseModel):
    """A table of the certificate."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, populate_by_name=True)


class Issuer(Facts):
    """Who answers for the certificate, and what made it."""

    shop: str = Field(description="as the cell's [certificate] names it; may be empty")
    operator: str = Field(description="who answers for it; empty: nobody was named")
    program: str
    version: str


class PartFacts(Facts):
    """The part, and what its drawing wants."""

    id: str
    job: str
    customer: str
    drawing: str = Field(description="number and revision, as whoever issued it named them")
    outline: str = Field(description="in words")
    edge_mm: float = Field(description="width of the rim that is outside the clear aperture")
    form: str = Field(description="the form wanted, in words")
    alignment: Literal["piston", "tilt", "power"] = Field(
        description="what of a map is no figure; each with the former"
    )


class Judgement(Facts):
    """A line of the drawing, and what a measurement had."""

    what: str
    value: float
    limit: float
    unit: str
    uncertainty: float | None = Field(description="by how much the instrument's repeatability may change it, at most")
    bound: float | None = Field(description="95 % bound of what is true; null: judged as measured")
    guard: float | None
    removed: str
    holds: bool


class CertificateVerdict(Facts):
    """Whether the part is what its drawing wants."""

    state: State
    words: str
    decided_by: str = Field(description="the line that is the farthest beyond its limit, or the nearest to it")
    lines: list[Judgement]
    unsure_lines: int = Field(description="whose limit lies within their uncertainty: either verdict is possible")
    outcome: str = Field(description="how the job ended, as summary.json has it")
    final: bool = Field(description="false: the job was stopped, and can go on")


class Commissioning(Facts):
    """The proof of the instrument's profile."""

    at: datetime
    artefact: str
    map_sha256: str
    correlation: float
    next_best: float
    profile_sha256: str


class InstrumentFacts(Facts):
    """What measured, and why it is believed."""

    profile: str
    measured_by: str = Field(description="as the last map's file names it")
    commissioned: Commissioning | None
    not_commissioned: str = Field(description="why; empty where it is")
    repeatability_nm: float | None
    system_map_sha256: str = Field(description="the instrument's own error, taken off each map; empty: none was")


class Uncertainty(Facts):
    """How sure the verdict is."""

    accepted: Literal["figure", "bound", "bound_without_power"]
    statements: list[str]


class CertificateAperture(Facts):
    """Which samples the figures are of: of all surfaces alike."""

    words: str
    pitch_mm: float | None
    samples: int = Field(description="of the last map in the clear aperture")
    grid_pitch_mm: float
    solve_samples: int = Field(description="of the process grid that the dwell was solved over")
    metric_samples: int = Field(description="of the process grid in the clear aperture")


class CertificateRegistration(Facts):
    """Where the part lay in a map."""

    by: str
    shift_mm: tuple[float, float]
    rotation_deg: float


class CertificateMeasurement(Facts):
    """A map of the part."""

    cycle: int
    name: str = Field(description="start, or after which pass")
    taken: datetime
    map_sha256: str
    rms_nm: float
    pv_nm: float
    lsf_rms_nm: float
    lsf_period_mm: float
    band_rms_nm: float | None = Field(description="of the tolerance's periods, where it has any")
    samples: int
    spikes: int
    lines: list[Judgement]
    registration: CertificateRegistration
    notes: list[str]


class FigureChange(Facts):
    """A row of the comparison of before and after: those of Table V of the paper."""

    figure: str
    before_nm: float
    after_nm: float
    change: float | None = Field(description="after / before - 1; null: there was nothing before")


class CorrectableRange(Facts):
    """What no dwell with the tool could remove."""

    cutoff_period_mm: float = Field(
        description="shorter periods are out of reach of the spot, of several tools that of the finest"
    )
    before_nm: float = Field(description="RMS of those of the first map")
    after_nm: float = Field(description="RMS of those of the last map: what no further pass would take away")


class Band(Facts):
    """RMS of a band of periods."""

    name: str
    from_mm: float | None
    to_mm: float | None
    rms_nm: float | None
    soft: bool = Field(description="fewer than three of its longest periods fit on the part")


class Psd(Facts):
    """Radially averaged two-dimensional power spectral density."""

    frequency_per_mm: list[float]
    density_nm2_mm2: list[float]


class ZernikeTerm(Facts):
    """A term of the fit."""

    index: int
    n: int
    m: int
    nm: float


class Zernike(Facts):
    """Zernike terms by least squares over the clear aperture."""

    ordering: str
    norm: str
    radius_mm: float | None
    residual_rms_nm: float
    condition: float
    terms: list[ZernikeTerm]


class CertificateIso10110(Facts):
    """ISO 10110-5:2015, in nm of surface."""

    a_nm: float
    b_nm: float
    c_nm: float
    rms_t_nm: float
    rms_i_nm: float
    rms_a_nm: float
    indication: str
    wavefront_indication: str = Field(description="ISO 10110-14:2018, of one reflection")


class CertificateSlope(Facts):
    """Slope over the integration length."""

    integration_mm: float
    rms_urad: float
    max_urad: float


class CertificateSurface(Facts):
    """All figures of one map, over the clear aperture of its own samples, less what is alignment."""

    cycle: int
    map_sha256: str
    pv_nm: float
    rms_nm: float
    bands: list[Band] | None
    psd: Psd | None
    zernike: Zernike | None
    iso10110: CertificateIso10110 | None
    slope: CertificateSlope | None
    wavelength_nm: float


class PassPlan(Facts):
    """What a pass was planned to do."""

    dwell_s: float
    expected_low_nm: float | None = Field(description="RMS that the next map was to show: 9 of 10 lie above")
    expected_median_nm: float | None
    expected_high_nm: float | None
    program_sha256: str
    blocks: int


class PassExecution(Facts):
    """What it did."""

    how: Literal["done", "interrupted", "begun"]
    share: float | None = Field(description="executed time over planned")
    executed_s: float = Field(description="known to have been in contact")
    blocks: int = Field(description="that are recorded as executed")
    uncertain_blocks: list[tuple[int, int]] = Field(description="nobody knows whether the tool touched: first, last")
    force_n: float | None = Field(description="mean in contact, weighted by time")
    rpm: float | None


class PassEstimate(Facts):
    """What the map after it told of it."""

    measured_rms_nm: float | None = Field(description="of the next map; null: none was taken")
    as_expected: bool | None
    rate: float | None = Field(description="removal rate that it showed, relative to the model's own")
    rate_sigma: float | None
    notes: list[str]


class CertificatePass(Facts):
    """A pass; one that was interrupted has no number."""

    name: str
    number: int | None
    cycle: int
    tool: str
    begun: datetime
    ended: datetime | None
    planned: PassPlan
    did: PassExecution
    taught: PassEstimate


class Anomaly(Facts):
    """Something that somebody had to see to, and what was done."""

    at: datetime
    kind: str
    what: str
    done: str


class File(Facts):
    """A file of the run folder."""

    name: str
    bytes: int
    sha256: str


class CertificateEvent(Facts):
    """A row of the journal's events."""

    at: datetime
    cycle: int | None
    name: str
    data: dict[str, Any]


class JournalFacts(Facts):
    """The journal of the job."""

    sha256: str = Field(description="of its rows: docs/certificate.md says how")
    rows: dict[str, int] = Field(description="by table")
    events: list[CertificateEvent] = Field(description="all but progress")


class PdfFacts(Facts):
    """The PDF beside the twin."""

    name: str
    sha256: str
    bytes: int
    pages: int


class Signature(Facts):
    """Ed25519 over the canonical bytes."""

    algorithm: Literal["Ed25519"]
    key: str = Field(description="public key, 32 bytes in base64")
    key_id: str = Field(description="first 16 hexadecimal digits of its sha256")
    value: str = Field(description="64 bytes in base64")


class Seal(Facts):
    """What makes a change show: over everything else in the file."""

    sha256: str = Field(description="of the canonical bytes")
    signature: Signature | None


class Content(Facts):
    """A certificate before there is a PDF of it."""

    schema_: Literal["polishd-certificate-1"] = Field(alias="schema")
    number: str
    issued: datetime
    issuer: Issuer
    part: PartFacts
    verdict: CertificateVerdict
    uncertainty: Uncertainty
    instrument: InstrumentFacts
    aperture: CertificateAperture
    measurements: list[CertificateMeasurement]
    changes: list[FigureChange]
    beyond_reach: CorrectableRange | None
    before: CertificateSurface | None
    after: CertificateSurface | None
    passes: list[CertificatePass]
    anomalies: list[Anomaly]
    versions: dict[str, str]
    files: list[File]
    journal: JournalFacts
    left_out: list[str]


class PartCertificate(Content):
    """The certificate of a part: the twin of a PDF."""

    pdf: PdfFacts
    seal: Seal


def schema() -> dict[str, Any]:
    """JSON Schema of the twin, draft 2020-12."""
    found = PartCertificate.model_json_schema(by_alias=True, mode="serialization")
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **found}
