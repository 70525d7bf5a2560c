// Says how many of the gallery's cards the filters leave, and hides the others where the style sheet can't.
for (const grid of document.querySelectorAll(".rhi-cards")) {
  const cards = [...grid.querySelectorAll("li")];
  const count = grid.querySelector(".rhi-card-count");
  const update = () => {
    const tags = [...grid.querySelectorAll("input:checked")].map((radio) => radio.value).filter(Boolean);
    for (const card of cards) {
      const has = card.dataset.tags.split(" ");
      card.hidden = !tags.every((tag) => has.includes(tag));
    }
    count.textContent = `${cards.filter((card) => !card.hidden).length} of ${cards.length} programs`;
  };
  grid.addEventListener("change", update);
  update();
}
