// Weights of Sphinx's search: keys, options and names of the interface come before titles, and these before words in a text.
var Scorer = {
  objNameMatch: 40,
  objPartialMatch: 30,
  objPrio: { 0: 15, 1: 5, 2: -5 },
  objPrioDefault: 0,
  title: 15,
  partialTitle: 7,
  term: 5,
  partialTerm: 2,
};
