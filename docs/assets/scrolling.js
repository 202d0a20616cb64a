// What is wider than its place scrolls; whoever has no mouse reaches it by the Tab key.
const reachable = () => {
  for (const place of document.querySelectorAll("pre > code, .md-typeset__scrollwrap, .md-typeset__table, .formula")) {
    if (place.scrollWidth > place.clientWidth) {
      place.tabIndex = 0;
    }
  }
};
window.addEventListener("load", reachable);
window.addEventListener("resize", reachable);
