# SPDX-License-Identifier: Apache-2.0
"""The page of a batch: how many say yes, which do not, and why."""

from collections.abc import Mapping
from typing import Any

from pam_orthosis.report.page import BAD, GOOD, Page, Part, listed
from pam_orthosis.report.plots import AFTER, Plot, bars

ERROR = "max_abs_error_"
ANSWERS = {0: "yes", 1: "no"}


def page(summary: Mapping[str, Any], results: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the page of `batch.json`, and name -> `result.json` of each unit that is done."""
    yes, no, failed = (len(summary[kind]) for kind in ("yes", "no", "failed"))
    headline = f"{yes} say yes, {no} say no, {failed} failed, {len(summary['missing'])} are missing."
    rows = [
        (name, f"failed after {one['tries']} tries", one["why"]) for name, one in summary["failed"].items()
    ]
    rows += [(name, ANSWERS[one["status"]], _told(one)) for name, one in results.items()]
    parts = [
        Part("Each of them", table=listed(("name", "answer", "what it is"), rows), plots=_errors(results))
    ]
    good = not (no or failed or summary["missing"])
    answer, tone = ("all yes", GOOD) if good else ("not all yes", BAD)
    about = "many bags or parameter sets"
    return Page("batch", answer, tone, headline, (), parts, about).html()


def _told(result: Mapping[str, Any]) -> str:
    """Return what an answer says: the error of a tracking, or the effects of a gap search."""
    answer = result["answer"] or {}
    if (kind := _kind(answer)) is not None:
        return f"maximum error {answer[kind]:.3f} {kind.removeprefix(ERROR)}"
    names = ", ".join(one["name"].replace("_", " ") for one in answer.get("effects", []))
    return " ".join(filter(None, [answer.get("verdict", ""), names])) or "done"


def _kind(answer: Mapping[str, Any]) -> str | None:
    return next((key for key in answer if key.startswith(ERROR) and "first" not in key), None)


def _errors(results: Mapping[str, Mapping[str, Any]]) -> list[Plot]:
    answers = {name: one["answer"] or {} for name, one in results.items()}
    kinds = {_kind(answer) for answer in answers.values()}
    if len(kinds) != 1 or None in kinds or len(answers) > 60:
        return []
    (kind,) = kinds
    unit, values = str(kind).removeprefix(ERROR), [answer[kind] for answer in answers.values()]
    alt = f"maximum errors of {len(values)} runs, {min(values):.2f} to {max(values):.2f} {unit}"
    trace = bars(list(answers), values, "maximum error", AFTER)
    return [Plot("Maximum error of each", alt, "", f"error / {unit}", [trace])]
