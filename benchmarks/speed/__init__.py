# SPDX-License-Identifier: Apache-2.0
"""Speed, measured in ratios: one module a group, each with a function `rows(repeats)` that yields `Row`s."""

GROUPS = {
    "graph": "the node graph against bare relays of the same messages",
    "device": "two legs with shoes in one process, recorder included, against relays of the same messages",
    "start": "commands and graph until they do something",
    "bags": "bags written and read",
    "latency": "from sample to answer in real time",
    "simulation": "the plant with every effect on, one and many at once",
    "scaling": "the gap workflow and identification against the size of what they work on",
}
