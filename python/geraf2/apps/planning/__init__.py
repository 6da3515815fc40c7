"""Plan of a scan before it is made: spacing, planes, time, coverage, the next plane."""
