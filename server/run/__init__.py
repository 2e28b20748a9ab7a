"""A run: its learner, its commands, its history and its keyframes."""
