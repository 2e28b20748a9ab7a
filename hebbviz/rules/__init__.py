"""The contract of a rule. A file of your own imports from here."""

from hebbviz.rules.base import Rule, parameter

__all__ = ["Rule", "parameter"]
