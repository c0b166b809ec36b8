# SPDX-License-Identifier: Apache-2.0
"""What `--help` of each verb ends with: examples, and what its exit status means."""

STATUSES = "Exit status: 0 good, 1 the answer is no, 2 unusable input or usage, 3 a node or the run failed."

ANSWERS = {
    "run": ("the bound holds", "the bound does not hold"),
    "session": ("the programme is carried out", "the session ended early"),
    "replay": ("all answers are equal, but for rounding", "answers differ, or most could not be compared"),
    "check": ("the bound holds", "the bound does not hold, the run ended released, or the bag is incomplete"),
    "rig": ("the bags are recorded", ""),
    "identify": ("the muscle is identified", ""),
    "gap": ("the gap is explained, or there is none", "the gap is not explained, or in part only"),
    "report": ("the files are written", ""),
    "paper": ("the page is written", ""),
    "improve": ("the machine follows better", "the machine follows no better"),
    "margin": ("the margins are measured", ""),
    "plan": ("the plan is written", ""),
    "batch": ("all answers are yes", "one answer is no"),
    "gap-hide": ("the case is written", ""),
    "recover": ("the new bag is written", ""),
    "example": ("the example is written", ""),
}  # verb -> meaning of 0 and of 1

EXAMPLES = {
    "run": (
        "pam-orthosis run --list",
        "pam-orthosis run --duration 10 --out walk",
        "pam-orthosis run --scenario person --composed",
        "pam-orthosis run --composed --param control.position.c1=30 --bound-deg 2",
        "pam-orthosis run --legs 2 --composed",
        "pam-orthosis run --watch",
        "pam-orthosis run --model found/model.yaml",
        "pam-orthosis run --realtime --duration 10",
        "pam-orthosis run --machine cylinder.yaml --composed",
    ),
    "session": (
        "pam-orthosis session programme.yaml --out monday",
        "pam-orthosis session programme.yaml --json",
    ),
    "replay": (
        "pam-orthosis replay walk",
        "pam-orthosis replay walk --node position_controller --param control.position.c1=30",
    ),
    "check": (
        "pam-orthosis check walk",
        "pam-orthosis check walk --bound-deg 1 --skip-s 2 --json",
        "pam-orthosis check walk --partial",
    ),
    "rig": (
        "pam-orthosis rig --out rig",
        "pam-orthosis rig --tests diagnostic --out rigbags",
    ),
    "identify": (
        "pam-orthosis identify rig --out muscle.yaml --figures figures",
        "pam-orthosis identify table.csv --muscle dmsp_20 --nominal-length-m 0.3",
        "pam-orthosis identify table.csv --machine elbow.yaml",
    ),
    "gap": (
        "pam-orthosis gap case/training_gait case/training_diagnostic"
        " --held-out case/held_out_gait case/held_out_diagnostic --out found",
        "pam-orthosis gap case/training_gait --until check",
        "pam-orthosis gap recording.csv --model nominal.yaml --json",
        "pam-orthosis gap cylinder.csv --machine cylinder.yaml",
        "pam-orthosis gap carriage.csv --system motor_carriage.py",
    ),
    "report": (
        "pam-orthosis report wednesday --earlier monday --out training",
        "pam-orthosis report walk --out report",
        "pam-orthosis report walk --only table --out report",
        "pam-orthosis report walk --animation walk.gif",
    ),
    "paper": ("pam-orthosis paper --out paper",),
    "improve": (
        "pam-orthosis improve --out better",
        "pam-orthosis improve --scenario person --rounds 1 --out better-person",
        "pam-orthosis improve --machine cylinder.yaml --out better-cylinder",
    ),
    "margin": (
        "pam-orthosis margin --out margin",
        "pam-orthosis margin --scenario person --json",
        "pam-orthosis margin --param control.position.c1=30 --param control.position.c2=30",
        "pam-orthosis margin --model better/model.yaml",
    ),
    "plan": (
        "pam-orthosis plan --scenario person --out planned.yaml",
        "pam-orthosis plan --scenario person --model better/model.yaml --after walked --out planned.yaml",
    ),
    "batch": (
        "pam-orthosis batch check walk person --out judged",
        "pam-orthosis batch gap BAG... --out found --retries 2 --timeout 600",
        "pam-orthosis batch study study.yaml --out walks",
    ),
    "gap-hide": (
        "pam-orthosis gap-hide --effect joint_friction --out case",
        "pam-orthosis gap-hide --class realistic --effect random --seed 7 --out case",
        "pam-orthosis gap-hide --machine ankle --effect plantarflexor_leak --out case",
        "pam-orthosis gap-hide --effect none --out case",
    ),
    "recover": ("pam-orthosis recover walk --out walk-recovered",),
    "example": (
        "pam-orthosis example --list",
        "pam-orthosis example walk",
        "pam-orthosis example friction --out case",
    ),
}


def statuses(verb: str) -> str:
    """Return what the exit statuses of a verb mean, in one line."""
    good, no = ANSWERS[verb]
    return f"0 {good}, {f'1 {no}, ' if no else ''}2 unusable input or usage, 3 failed"


def epilog(verb: str) -> str:
    """Return what the help of a verb ends with."""
    lines = "\n".join(f"  {line}" for line in EXAMPLES[verb])
    return f"examples:\n{lines}\n\nexit status: {statuses(verb)}"
