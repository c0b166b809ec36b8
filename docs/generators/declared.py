# SPDX-License-Identifier: Apache-2.0
"""Parameters that nodes declare, asked of nodes that are made for it."""

import importlib
import inspect
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from pam_orthosis.nodes.launch import environment, free_domain

GIVEN = {
    "pressure_controller": ("muscle:=extensor",),
    "safety_monitor": ("control.limits.enabled:=true",),
}
OF_RCLPY = ("use_sim_time", "start_type_description_service")


class Declared(NamedTuple):
    """A parameter of a node."""

    name: str
    value: Any
    meaning: str
    constraints: str


@cache
def declared(module: str) -> tuple[Declared, ...]:
    """Return the parameters of a node by the name of its module, those of every ROS node left out."""
    with made(module, *GIVEN.get(module, ())) as node:
        names = [name for name in node.list_parameters([], 0).names if name not in OF_RCLPY]
        described = [(node.get_parameter(name).value, node.describe_parameter(name)) for name in names]
    return tuple(
        Declared(name, value, said.description, said.additional_constraints)
        for name, (value, said) in zip(names, described, strict=True)
    )


@contextmanager
def made(module: str, *settings: str) -> Iterator[Any]:
    """Make the node of a module with some parameters (`name:=value`), alone in its domain; destroy it."""
    import rclpy

    loaded = importlib.import_module(f"pam_orthosis.nodes.{module}")
    (kind,) = (one for one in vars(loaded).values() if inspect.isclass(one) and _is_node(one, loaded))
    here, kept = Path.cwd(), dict(os.environ)
    words = [word for one in settings for word in ("-p", one)]
    with tempfile.TemporaryDirectory() as folder, free_domain() as domain:
        try:
            os.chdir(folder)  # a recorder begins its bag
            os.environ.update(environment(Path(folder), domain))
            rclpy.init(args=["--ros-args", *words])
            node = kind()
            yield node
            node.destroy_node()
        finally:
            rclpy.try_shutdown()
            os.chdir(here)
            os.environ.clear()
            os.environ.update(kept)


def _is_node(kind: type, module: Any) -> bool:
    from rclpy.node import Node

    return issubclass(kind, Node) and kind.__module__ == module.__name__
