"""Everything that only a card can show, in three parts; `scripts/gpu_check.sh` is the door."""
