"""Widgets that change the run."""
