"""Outside of the box, or a bare object, from photographs. `config` alone does not load torch."""
