"use strict";
{
  // Without scripts a picture leads to its page; with them the page takes the picture's place.
  const open = (event) => {
    if (event.ctrlKey || event.metaKey || event.shiftKey) return; // another tab or window
    event.preventDefault();
    const link = event.currentTarget, frame = document.createElement("iframe");
    Object.assign(frame, { src: link.href, title: link.querySelector("img").alt });
    frame.style.height = `${link.offsetHeight}px`;
    addEventListener("message", ({ source, data }) => {
      if (source === frame.contentWindow && data.figure > 0) frame.style.height = `${data.figure}px`;
    });
    link.replaceWith(frame);
  };
  for (const link of document.querySelectorAll("a.live")) link.addEventListener("click", open);
}
