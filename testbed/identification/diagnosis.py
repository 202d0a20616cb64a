"""What a careful reader of an estimate should know."""

from __future__ import annotations

from testbed.identification.estimate import Estimate

SIGNIFICANT = 0.3
"""Relative sigma above which a parameter is reported as poorly determined."""

SMALL = 0.01
"""Sigma, as a share of the largest value of the same unit, below which it is small all the same:
a parameter that is zero is then known to be."""

ILL_CONDITIONED = 1e3
"""Condition of the scaled equations above which the estimate is reported as doubtful."""


def quality_warnings(estimate: Estimate) -> list[str]:
    """Ill-conditioned equations, and parameters that the data hardly determine."""
    warnings = []
    if estimate.condition > ILL_CONDITIONED:
        warnings.append(
            f"the {estimate.method} equations are ill-conditioned ({estimate.condition:.1e}): "
            "errors of the instrument grow by up to that factor"
        )
    base = estimate.base
    largest: dict[str, float] = {}
    for unit, value in zip(base.units, base.values, strict=True):
        largest[unit] = max(largest.get(unit, 0.0), abs(value))
    loose = [
        f"{name} ({value:.3g} +- {sigma:.2g})"
        for name, unit, value, sigma in zip(
            base.names, base.units, base.values, base.sigma, strict=True
        )
        if sigma > SIGNIFICANT * abs(value) and sigma > SMALL * largest[unit]
    ]
    if loose:
        listed = ", ".join(loose)
        warnings.append(f"the {estimate.method} estimate leaves poorly determined: {listed}")
    return warnings
