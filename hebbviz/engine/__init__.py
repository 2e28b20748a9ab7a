"""The compiled engine: the rule's kernel, the closed loop, and the lanes that it steps."""
