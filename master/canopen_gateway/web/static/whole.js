// Whole numbers beyond 2^53: JavaScript's own numbers, and those that JSON.parse makes, are not exact there.

/** Return the value of an answer as text. One that JSON.parse may have rounded is taken from its bytes, which stand beside it. */
export function shown(found) {
  if (found.value === null) return found.hex;
  const isWhole = typeof found.value === "number" && /^(UNSIGNED|INTEGER)\d+$/.test(found.type);
  if (!isWhole || Number.isSafeInteger(found.value)) return `${found.value}`;
  const number = BigInt(`0x${found.hex.split(" ").reverse().join("")}`);
  return `${found.type.startsWith("INTEGER") ? BigInt.asIntN(8 * found.size, number) : number}`;
}

/** Return the body of a write as JSON, with a whole number as it was typed. type: of the object. */
export function bodyOf(typed, type) {
  const text = typed.trim();
  const isNumber = /^[-+]?(\d+\.?\d*([eE][-+]?\d+)?|0[xX][0-9a-fA-F]+)$/.test(text) && !/STRING|DOMAIN/.test(type);
  if (!isNumber) return JSON.stringify({ value: typed });
  return /^([-+]?\d+|0[xX].*)$/.test(text) ? `{"value": ${BigInt(text)}}` : JSON.stringify({ value: Number(text) });
}
