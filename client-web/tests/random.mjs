/** Reproducible random numbers, so that a failure can be repeated. */

/** Marsaglia's xorshift, 32 bits. */
export function randoms(seed) {
  let state = seed * 2654435761 >>> 0 || 1;
  const next = () => {
    state ^= state << 13;
    state ^= state >>> 17;
    state ^= state << 5;
    return state >>> 0;
  };
  const below = (n) => next() % n;
  return { below, bytes: (n) => Uint8Array.from({ length: n }, () => next() >>> 24) };
}
