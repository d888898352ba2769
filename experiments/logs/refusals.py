"""What becomes of the findings about a user's file: an error that names it, or notices."""

from collections.abc import Sequence

from surefoot.calibration import CalibrationRefused
from surefoot.calibration.in_situ.findings import Finding, decide


def pass_or_refuse(
    findings: Sequence[Finding], accept: str, file: str, written: str
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return notices of what was accepted, and those of weaker findings.

    Args:
        findings: What checks saw.
        accept: The reason to go on past what refuses; empty for none.
        file: What messages call the file.
        written: What says the reason, such as ``"every file"``.

    Raises:
        CalibrationRefused: With all that refuses, if there is no reason to go on.
    """
    decision = decide(findings, accept)
    if decision.refused:
        first, *others = decision.refused
        more = "".join(f" Also: {other.reason}" for other in others)
        more += f" If you know better: --accept REASON goes on, and {written} says so."
        raise CalibrationRefused(f"{file}: {first.reason}", f"{first.cure}{more}")
    passed = tuple(f"{file}: accepted ({accept}): {one.reason} {one.cure}" for one in decision.passed)
    return passed, tuple(f"{file}: {text}" for text in decision.warnings)
