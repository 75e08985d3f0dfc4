"""Robots: rigid bodies by pinocchio, a drivetrain for each joint, limits, tool and flange."""
