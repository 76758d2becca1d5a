"use strict";
{
  // Without scripts all claims are shown.
  const form = document.getElementById("claims-filter");
  const claims = [...document.querySelectorAll("ol.claims > li")];
  const filter = () => {
    const verdict = form.elements.verdict.value;
    const text = form.elements.text.value.trim().toLowerCase();
    let shown = 0;
    for (const claim of claims) {
      claim.hidden = (verdict && claim.dataset.verdict !== verdict) ||
        !claim.textContent.toLowerCase().includes(text);
      shown += !claim.hidden;
    }
    form.querySelector("output").textContent = `${shown} of ${claims.length} shown`;
  };
  form.hidden = false;
  form.addEventListener("input", filter);
  form.addEventListener("submit", (event) => event.preventDefault());
  filter();
}
