"""Commands that listen: what each robot is, holds and says, live or from a log."""
