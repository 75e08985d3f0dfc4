"""Baseline motions on the straight joint path: toppra's time-optimal one and the quintic one."""
