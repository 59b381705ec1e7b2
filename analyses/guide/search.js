// Search over search/search_index.js, which build.py writes. mkdocs' own script starts a worker, which browsers refuse
// to pages that are opened from a folder; this one does not.
(function () {
  function show(query) {
    const results = document.getElementById("mkdocs-search-results");
    if (!results) return;
    const { docs } = window.searchIndex;
    window.searchLunr = window.searchLunr || lunr(function () {
      this.ref("at");
      this.field("title", { boost: 10 });
      this.field("text");
      docs.forEach((d, at) => this.add({ at: String(at), title: d.title, text: d.text }));
    });
    let found = [];
    try { found = window.searchLunr.search(query); } catch (e) { found = []; }
    if (!found.length && /^[\w-]+$/.test(query)) found = window.searchLunr.search(query + "*");
    results.replaceChildren();
    const title = document.createElement("p");
    title.textContent = found.length + (found.length === 1 ? " place for " : " places for ") + "“" + query + "”";
    results.append(title);
    for (const one of found.slice(0, 30)) {
      const doc = docs[Number(one.ref)];
      const article = document.createElement("article"), head = document.createElement("h3");
      const link = document.createElement("a"), text = document.createElement("p");
      link.href = base_url.replace(/\/$/, "") + "/" + doc.location;
      link.textContent = doc.title;
      text.textContent = doc.text.slice(0, 200);
      head.append(link);
      article.append(head, text);
      results.append(article);
    }
  }
  document.addEventListener("DOMContentLoaded", function () {
    const query = new URLSearchParams(window.location.search).get("q");
    const box = document.getElementById("mkdocs-search-query");
    if (box && query) box.value = query;
    if (box) box.addEventListener("input", () => show(box.value.trim()));
    if (query) show(query);
  });
})();
