"""What a study sets out to reach: claims, each a number with its aim and a verdict that is computed."""

from collections.abc import Iterable
from dataclasses import dataclass

from surefoot.experiments.study.tables import Table, Verdict, number


@dataclass(frozen=True)
class Claim:
    """A claim: what is measured, with its unit; what it was to be; what it is; whether it was met."""

    what: str
    aim: str
    measured: str
    met: bool


def at_most(what: str, value: float, limit: float, measured: str = "") -> Claim:
    """Return the claim that a value is no larger than a limit.

    >>> at_most("CoP rmse (mm)", 1.234, 2.0)
    Claim(what='CoP rmse (mm)', aim='≤ 2', measured='1.23', met=True)
    """
    return Claim(what, f"≤ {limit:g}", measured or number(value), value <= limit)


def at_least(what: str, value: float, limit: float, measured: str = "") -> Claim:
    """Return the claim that a value is no smaller than a limit."""
    return Claim(what, f"≥ {limit:g}", measured or number(value), value >= limit)


def claim_table(claims: Iterable[Claim], title: str = "What was set out to reach", note: str = "") -> Table:
    """Return the table of claims, named ``targets``."""
    rows = tuple((claim.what, claim.aim, claim.measured, Verdict.of(claim.met)) for claim in claims)
    return Table("targets", title, ("what", "target", "measured", "reached"), rows, note)
