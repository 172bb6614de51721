"""All checks that only a GPU can do, in three parts; `scripts/gpu_check.sh` starts them."""
