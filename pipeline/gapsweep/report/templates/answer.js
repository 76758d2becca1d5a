"use strict";
{
  // One case of the numbers behind the map; without scripts all are shown.
  const cases = [...document.querySelectorAll("#numbers tbody")], choice = document.getElementById("one-case");
  const select = choice?.querySelector("select");
  select?.append(...cases.map((one, n) => new Option(one.rows[0].textContent, n)));
  select?.addEventListener("change", () => cases.forEach((one, n) => (one.hidden = select.value !== "" && n !== +select.value)));
  if (cases.length > 1) choice.hidden = false;
}
