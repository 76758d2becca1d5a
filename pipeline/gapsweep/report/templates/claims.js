"use strict";
{
  // Without scripts all claims are shown, folded.
  const form = document.getElementById("claims-filter");
  const claims = [...document.querySelectorAll("ol.claims > li")];
  const { verdict, text } = form.elements;
  const filter = () => {
    const words = text.value.trim().toLowerCase();
    let shown = 0;
    for (const claim of claims) {
      claim.hidden = (verdict.value && claim.dataset.verdict !== verdict.value) ||
        !claim.textContent.toLowerCase().includes(words);
      shown += !claim.hidden;
    }
    form.querySelector("output").textContent = `${shown} of ${claims.length} shown`;
  };
  // The address says what is shown: #claims?verdict=refuted&text=tanh. Others lead to a claim.
  const read = () => {
    const [place, query] = location.hash.slice(1).split("?");
    if (place !== "claims") return document.querySelector(`li:target > details`)?.setAttribute("open", "");
    const asked = new URLSearchParams(query);
    verdict.value = asked.get("verdict") ?? "";
    text.value = asked.get("text") ?? "";
    filter();
    document.getElementById("claims").scrollIntoView();
  };
  form.hidden = false;
  form.addEventListener("input", () => {
    const asked = new URLSearchParams({ verdict: verdict.value, text: text.value });
    history.replaceState(null, "", `#claims?${asked}`);
    filter();
  });
  form.addEventListener("submit", (event) => event.preventDefault());
  addEventListener("hashchange", read);
  filter();
  read();
}
