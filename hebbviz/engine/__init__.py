"""The compiled engine: the rule's kernel, the closed loop, and blocks of lanes."""
