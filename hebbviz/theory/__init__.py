"""POMDPs, their policies and Markov chains: exact values to hold estimates against."""
