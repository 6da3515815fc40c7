"""Plan of a scan before it is made: spacing, planes, time, and coverage."""
