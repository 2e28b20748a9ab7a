"""The contract of a rule. Files that define a rule import from here."""

from hebbviz.rules.base import Rule, parameter

__all__ = ["Rule", "parameter"]
