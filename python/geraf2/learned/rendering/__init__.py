"""From a learned distance to signals (`lensless`) and to pictures (`neus`)."""
