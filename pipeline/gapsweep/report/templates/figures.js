"use strict";
{
  // Without scripts a picture leads to its page; with them the page takes the picture's place.
  const toggle = (event) => {
    if (event.ctrlKey || event.metaKey || event.shiftKey) return; // another tab or window
    event.preventDefault();
    const figure = event.currentTarget.closest("figure"), button = figure.querySelector(".explore");
    const opened = figure.querySelector("iframe");
    button.textContent = opened ? "explore" : "close";
    if (opened) return opened.replaceWith(figure.picture);
    const picture = (figure.picture = figure.querySelector("a.live")), frame = document.createElement("iframe");
    Object.assign(frame, { src: picture.href, title: picture.firstElementChild.alt });
    frame.style.height = `${picture.offsetHeight}px`;
    picture.replaceWith(frame);
    button.focus();
  };
  addEventListener("message", ({ source, data }) => {
    const frame = [...document.querySelectorAll("iframe")].find((one) => one.contentWindow === source);
    if (frame && data.figure > 0) frame.style.height = `${data.figure}px`;
  });
  for (const link of document.querySelectorAll("a.live, a.explore")) link.addEventListener("click", toggle);
}
