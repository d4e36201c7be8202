"""Where scenes are worked on: in this process, in several of this machine, or on a cluster."""

from bench.executors.executor import Executor, InThisProcess, Resources

__all__ = ["Executor", "InThisProcess", "Resources"]
