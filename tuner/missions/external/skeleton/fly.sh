#!/bin/sh
# One mission: what it needs is in the environment (and as JSON in $GATETUNE_REQUEST), its result goes to $GATETUNE_RESULT.
# An end without a result counts as the machine's failure: flown again.
answer() { printf '{"schema": "gatetune.result/1", %s}' "$1" > "$GATETUNE_RESULT.part" && mv "$GATETUNE_RESULT.part" "$GATETUNE_RESULT"; exit; }
failed() { answer '"status": "failed", "failure": {"of": "configuration", "reason": "'"$1"'"}'; }

[ "$GATETUNE_CHECK" = fail ] && failed asked_to_fail   # gatetune mission check wants to see a failure
file=$GATETUNE_INSTANCE.raw
filters=
[ "$PARAMETER_delta" != 0 ] && filters=--delta=dist=$PARAMETER_delta
options=lc=$PARAMETER_lc,lp=$PARAMETER_lp,pb=$PARAMETER_pb,nice=$PARAMETER_nice
xz --stdout --format=raw $filters --lzma2="$options" "$file" > "$SCRATCH/packed"
case $? in
  0) ;;
  1) failed refused ;;
  *) exit 1 ;;
esac
percent=$(echo "$(wc -c < "$SCRATCH/packed") $(wc -c < "$file")" | awk '{printf "%.6f", 100 * $1 / $2}')
answer '"status": "ok", "metrics": {"packed_percent": '"$percent"'}'
