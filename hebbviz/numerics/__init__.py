"""Compilation, random numbers and σ, which all compiled functions use."""
