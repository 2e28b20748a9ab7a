"""The pendulum: the task in pymunk, and the same compiled for many lanes."""

from hebbviz.sims.worlds.pendulum.task import Pendulum

__all__ = ["Pendulum"]
