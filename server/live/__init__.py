"""The live session: the thread that steps the run, and the snapshots that views draw."""
