"""Compiling, random numbers and σ: what every compiled function is made with."""
