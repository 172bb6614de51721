"""All checks that only a card can do, in three parts; `scripts/gpu_check.sh` starts them."""
