# SPDX-License-Identifier: Apache-2.0
"""How old samples are when a node is done with them."""


class Ages:
    """How old samples are when a node is done with them, since the last report, and how many were too old."""

    def __init__(self, deadline_ns: int):
        self._deadline_ns = deadline_ns
        self._ages: list[int] = []
        self.missed = 0

    def add(self, age_ns: int) -> None:
        """Count a sample."""
        self._ages.append(age_ns)
        self.missed += age_ns > self._deadline_ns

    def figures(self) -> dict[str, float]:
        """Return mean and largest age, ms, and begin anew."""
        ages, self._ages = self._ages, []
        if not ages:
            return {}
        return {"latency_mean_ms": sum(ages) / len(ages) / 1e6, "latency_max_ms": max(ages) / 1e6}
