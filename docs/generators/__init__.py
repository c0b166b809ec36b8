# SPDX-License-Identifier: Apache-2.0
"""Makers of the generated documentation: whole pages, and tables in pages that are written by hand."""

from collections.abc import Callable


def pages() -> dict[str, str]:
    """Return the generated pages: path below docs/ -> Markdown."""
    from generators import cli, effects, equations, machines, nodes, notebooks, parameters, scenarios

    made: dict[str, str] = {}
    for maker in (cli, effects, equations, machines, nodes, notebooks, parameters, scenarios):
        made |= maker.pages()
    return made


def blocks() -> dict[str, Callable[[], str]]:
    """Return the generated tables: name -> what makes its Markdown."""
    from generators import cli, faults, nodes, results, scenarios

    tables = {"topics": nodes.topic_table, "scene": nodes.scene_table, "exit": cli.exit_table}
    tables["experiments"] = scenarios.experiment_table
    return {**tables, **faults.blocks(), **results.blocks()}
