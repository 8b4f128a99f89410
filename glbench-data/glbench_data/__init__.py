"""All baselines and released results of glbench, which finds them here by itself. Data only: nothing to import."""
