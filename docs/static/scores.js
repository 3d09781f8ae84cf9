// How the search ranks what it finds: pages before names of Python (Sphinx has objects first), and those first whose title has all
// words that were asked for; for the number of an object, the index of objects.
var objectNumber = /^(0x)?[0-9][0-9a-f]{3}$/i;
var askedWords = (new URLSearchParams(window.location.search).get("q") || "").toLowerCase().match(/[\p{L}\p{N}]+/gu) || [];
var Scorer = {
  objNameMatch: 6,
  objPartialMatch: 1,
  objPrio: { 0: 0, 1: -2, 2: -4 },
  objPrioDefault: 0,
  title: 15,
  partialTitle: 7,
  term: 5,
  partialTerm: 2,
  score: ([page, title, , , score, , kind]) => {
    const isNamed = kind !== "object" && askedWords.length > 0 && askedWords.every((word) => title.toLowerCase().includes(word));
    const isIndex = page === "objects" && askedWords.some((word) => objectNumber.test(word));
    return isNamed || isIndex ? score + 20 : score;
  },
};
// The words of a query. An object may be asked for without its 0x: Sphinx itself leaves out what has digits alone.
var splitQuery = (query) =>
  query
    .split(/[^\p{Letter}\p{Number}_\p{Emoji_Presentation}]+/gu)
    .filter((word) => word)
    .map((word) => (objectNumber.test(word) && !/^0x/i.test(word) ? `0x${word}` : word));
