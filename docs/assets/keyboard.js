// For those who have no mouse. What is wider than its place scrolls, and the Tab key reaches it;
// the theme's hidden switches of colours, which the system sets here, it passes by.
const WIDE = "pre > code, .md-typeset__scrollwrap, .md-typeset__table, .formula";
const reachable = () => {
  for (const place of document.querySelectorAll(WIDE)) {
    if (place.scrollWidth > place.clientWidth) {
      place.tabIndex = 0;
    }
  }
  for (const input of document.querySelectorAll("input.md-option[aria-hidden]")) {
    input.tabIndex = -1;
  }
};
window.addEventListener("load", reachable);
window.addEventListener("resize", reachable);
