"""Content of a certificate's JSON file. docs/reference/certificate.schema.json is written from these models.

Numbers have their unit in their name. A value that is null is not known; ``left_out`` has the reason.
"""

from __future__ import annotations

from datetime import datetime
from typing import Any, Final, Literal

from pydantic import BaseModel, ConfigDict, Field

SCHEMA: Final = "polishd-certificate-1"
State = Literal["in tolerance", "not in tolerance", "not known"]


class Facts(BaseModel):
    """A table of the certificate."""

    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        allow_inf_nan=False,
        populate_by_name=True,
        json_schema_serialization_defaults_required=True,  # a value that older records lack is null, never left out
    )


class Issuer(Facts):
    """Issuer of the certificate, and the program that made it."""

    shop: str = Field(description="certificate.shop of the cell; may be empty")
    operator: str = Field(description="person responsible for the certificate; may be empty")
    program: str
    version: str


class PartFacts(Facts):
    """The part, and its nominal form."""

    id: str
    job: str
    customer: str
    drawing: str = Field(description="number and revision of the drawing")
    outline: str = Field(description="as text")
    edge_mm: float = Field(description="width of the rim that is outside the clear aperture")
    form: str = Field(description="nominal form, as text")
    alignment: Literal["piston", "tilt", "power"] = Field(
        description="terms that are removed from a map; each includes the one before it"
    )


class HiddenRipple(Facts):
    """Forecast ripple of all passes in a band, as far as the samples of the last map do not show it. Not measured."""

    name: str
    from_mm: float | None
    to_mm: float | None
    rms_nm: float = Field(description="with spot and path as modelled")
    rms_high_nm: float = Field(description="95 % value: with the errors of spot, lines and lag in the cell's settings")


class Judgement(Facts):
    """A line of the drawing, and the value of a measurement."""

    what: str
    value: float
    limit: float
    unit: str
    uncertainty: float | None = Field(description="greatest change by the instrument's repeatability")
    bound: float | None = Field(description="95 % bound of the true value; null: judged as measured")
    guard: float | None
    with_ripple: float | None = Field(
        default=None, description="value with the forecast ripple that the map does not show; null: there is none"
    )
    with_ripple_high: float | None = Field(default=None, description="the same with the ripple's 95 % value")
    removed: str
    holds: bool


class CertificateVerdict(Facts):
    """Verdict on the part by its drawing."""

    state: State
    words: str
    decided_by: str = Field(description="the line farthest beyond its limit, or nearest to it")
    lines: list[Judgement]
    unsure_lines: int = Field(description="lines whose limit lies within their uncertainty: either verdict is possible")
    outcome: str = Field(description="outcome of the job in summary.json")
    final: bool = Field(description="false: the job was stopped and can be continued")


class Commissioning(Facts):
    """Commissioning of the instrument's profile."""

    at: datetime
    artefact: str
    map_sha256: str
    correlation: float
    next_best: float
    profile_sha256: str


class InstrumentFacts(Facts):
    """Instrument and its commissioning."""

    profile: str
    measured_by: str = Field(description="name of the instrument in the last map's file")
    commissioned: Commissioning | None
    not_commissioned: str = Field(description="reason; empty if it is commissioned")
    repeatability_nm: float | None
    system_map_sha256: str = Field(description="system error that is subtracted from each map; empty: none")


class Uncertainty(Facts):
    """Uncertainty of the verdict."""

    accepted: Literal["figure", "bound", "bound_without_power"]
    statements: list[str]


class CertificateAperture(Facts):
    """Samples of the figures, the same for all surfaces."""

    words: str
    pitch_mm: float | None
    samples: int = Field(description="samples of the last map in the clear aperture")
    grid_pitch_mm: float
    solve_samples: int = Field(description="samples of the process grid that the dwell was solved for")
    metric_samples: int = Field(description="samples of the process grid in the clear aperture")


class CertificateRegistration(Facts):
    """Position of the part in a map."""

    by: str
    shift_mm: tuple[float, float]
    rotation_deg: float


class CertificateMeasurement(Facts):
    """A map of the part."""

    cycle: int
    name: str = Field(description="start, or the pass before it")
    taken: datetime
    map_sha256: str
    rms_nm: float
    pv_nm: float
    lsf_rms_nm: float
    lsf_period_mm: float
    band_rms_nm: float | None = Field(description="of the periods of the tolerance; null: of all")
    samples: int
    spikes: int
    lines: list[Judgement]
    registration: CertificateRegistration
    notes: list[str]


class FigureChange(Facts):
    """A row of the comparison of before and after: Table V of the paper."""

    figure: str
    before_nm: float
    after_nm: float
    change: float | None = Field(description="after / before - 1; null: before is 0")


class CorrectableRange(Facts):
    """RMS beyond the reach of the tool."""

    cutoff_period_mm: float = Field(
        description="shorter periods are beyond the reach of the spot; of several tools, of the finest"
    )
    before_nm: float = Field(description="RMS of these periods of the first map")
    after_nm: float = Field(description="RMS of these periods of the last map: a further pass cannot remove it")


class Band(Facts):
    """RMS of a band of periods."""

    name: str
    from_mm: float | None
    to_mm: float | None
    rms_nm: float | None
    soft: bool = Field(description="fewer than three of the longest periods fit on the part")


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
    """Figures of one map, over the clear aperture of its samples, alignment removed."""

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
    """Plan of a pass."""

    dwell_s: float
    expected_low_nm: float | None = Field(description="expected RMS of the next map: 9 of 10 lie between low and high")
    expected_median_nm: float | None
    expected_high_nm: float | None
    program_sha256: str
    blocks: int


class PassExecution(Facts):
    """Execution of a pass."""

    how: Literal["done", "interrupted", "begun"]
    share: float | None = Field(description="executed time over planned")
    executed_s: float = Field(description="time that is known to be in contact")
    blocks: int = Field(description="recorded as executed")
    uncertain_blocks: list[tuple[int, int]] = Field(description="contact is not known: first, last")
    force_n: float | None = Field(description="mean in contact, weighted by time")
    rpm: float | None


class PassEstimate(Facts):
    """Result of a pass, from the next map."""

    measured_rms_nm: float | None = Field(description="of the next map; null: there is none")
    as_expected: bool | None
    rate: float | None = Field(description="removal rate relative to the nominal rate")
    rate_sigma: float | None
    notes: list[str]


class CertificatePass(Facts):
    """A pass. An interrupted pass has no number."""

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
    """An event that needed the operator, and the action."""

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

    sha256: str = Field(description="of its rows, as defined in docs/how-to/certificate.md")
    rows: dict[str, int] = Field(description="by table")
    events: list[CertificateEvent] = Field(description="all but progress")


class PdfFacts(Facts):
    """The PDF of the same certificate."""

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
    """Checksum and signature over everything else in the file."""

    sha256: str = Field(description="of the canonical bytes")
    signature: Signature | None


class Content(Facts):
    """Content of a certificate without PDF and seal."""

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
    hidden_ripple: list[HiddenRipple] = Field(
        default=[], description="by band of the last map; empty: no pass has a forecast"
    )
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
    """The certificate of a part: the JSON file beside the PDF."""

    pdf: PdfFacts
    seal: Seal


def schema() -> dict[str, Any]:
    """Return the JSON Schema of a certificate, draft 2020-12."""
    found = PartCertificate.model_json_schema(by_alias=True, mode="serialization")
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **found}
