"""POMDPs, policies and Markov chains, which give exact values to compare estimates with."""
