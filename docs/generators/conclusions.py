# SPDX-License-Identifier: Apache-2.0
"""What each page of results says in one sentence, computed from the results."""

from statistics import median

from generators import results
from generators.results import BOUND, CONTROLLERS, LABELS


def gap() -> str:
    """Return how often the gap workflow is right."""
    every, newest = results.blind_cases(), results.latest_cases()
    medium, latest = (results.chosen_of(cases, "realistic", "medium") for cases in (every, newest))
    (found, tried), (now, asked) = results.right(medium), results.right(latest)
    both, pairs = results.both(results.chosen_of(every, "pairs"))
    none, nulls = results.quiet([r for r in every if r["set"].endswith("-none")])
    return (
        f"In realistic cases of medium size of the last sets the hidden effect was named in {now} of {asked}"
        f" ({now / asked:.0%}; asked are {results.ASKED['realistic', 'medium']:.0%}), in all sets in"
        f" {found} of {tried} ({found / tried:.0%}), where a wrong name was given in"
        f" {results.wrong(medium)[0]}. Of two effects at once, both were named in {both} of {pairs} cases."
        f" With nothing hidden, the answer was `none` in {none} of {nulls}."
    )


def tracking() -> str:
    """Return how well the knee follows on hardware as shipped and on other hardware."""
    rows = [r for r in results.delay_rows() if r["cascade"] == "predictor"]
    shipped = [r for r in rows if r["hardware"] == "as shipped"]
    alone, worn = (
        max(r["maximum"] for r in shipped if r["wearer"] == wearer) for wearer in ("nobody", "person")
    )
    return (
        f"On the shipped hardware the knee follows its gait within {alone:.2f} degrees, with a person within"
        f" {worn:.2f} degrees; with the changes of the second table, within"
        f" {max(r['maximum'] for r in rows):.2f} degrees."
    )


def controllers() -> str:
    """Return which controller follows best on drawn hardware."""
    runs = [r for r in results.drawn_runs() if r["case"] in results.TASKS]
    errors = {
        LABELS.get(name, name): [r["max_deg"] for r in runs if r["controller"] == name]
        for name in CONTROLLERS
    }
    most = max(map(len, errors.values()))
    middle = {name: median(many) for name, many in errors.items() if len(many) == most}
    best, *others = sorted(middle, key=lambda name: middle[name])
    behind = ", ".join(f"`{name}` {middle[name]:.2f}" for name in others)
    shown = {name: many for name, many in errors.items() if many}
    above = (f"`{name}` {sum(e > BOUND for e in many)} of {len(many)}" for name, many in shown.items())
    return (
        f"Of the controllers that walk all three tasks, `{best}` has the smallest maximum error: its median"
        f" is {middle[best]:.2f} degrees ({behind}). Runs beyond {BOUND:g} degrees: {', '.join(above)}."
    )


def speed() -> str:
    """Return how the graph compares with nodes that compute nothing."""
    rows = results.speed_rows()
    many, one = (
        rows[f"simulated time at 500 Hz, {how}, recorder included, beside that of the relays"]["ratio"]
        for how in ("processes", "one process")
    )
    latency = rows["latency at 200 Hz, one process: median"]["ours"]
    return (
        f"The graph simulates {many:.2g} times as fast as the same number of nodes that compute nothing, in"
        f" one process {one:.2g} times; there, a voltage leaves {latency:.3g} ms after its sample (median)."
    )


def paper() -> str:
    """Return the paper's three figures beside ours."""
    rows = {row["result"]: row for row in results.paper_results()["rows"]}
    moved = results.paper_results()["by_hand"]
    parts = [
        f"{words} {rows[name]['here'].split(',')[0]} (paper: {rows[name]['paper'].split(',')[0]})"
        for words, name in (
            ("the force model errs by", "force model, DMSP-20"),
            ("the estimated disturbance lags by", "lag of the estimated disturbance"),
            ("the knee deviates by at most", "maximum tracking error"),
        )
    ]
    vented, filled = (
        {joint: max(one[kind] for one in moved if one["joint"] == joint) for joint in ("knee", "ankle")}
        for kind in ("resistance", "filled")
    )
    return (
        f"In the emulation {parts[0]}, {parts[1]}, and {parts[2]}. With vented muscles a hand that moves the"
        f" knee overcomes {vented['knee']:.1f} N m beside weight and inertia, {vented['ankle']:.1f} N m at"
        f" the ankle; with filled ones {filled['knee']:.0f} and {filled['ankle']:.0f} N m."
    )


def conclusions() -> dict[str, str]:
    """Return the sentences by name."""
    return {one.__name__: one() for one in (gap, tracking, controllers, speed, paper)}
